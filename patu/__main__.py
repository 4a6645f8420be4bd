"""`python -m patu` is `patu`."""

from .main import run

run()
