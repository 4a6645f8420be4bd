"""A hydraulic log crane on the Exudyn multibody engine: description, recordings, effects, engine.

    from crane_exudyn import Crane, Recording, simulate

Names are imported when they are first asked for, so that `import crane_exudyn` costs nothing.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from .lazily import lazily

if TYPE_CHECKING:
    from .crane import Crane as Crane
    from .effects.registry import load_effects as load_effects
    from .engine import ExudynEngine as ExudynEngine
    from .errors import CraneError as CraneError
    from .linearised import linearise as linearise
    from .recording import Recording as Recording
    from .simulation import simulate as simulate

__version__ = "0.1.0"

_WHERE = {
    "Crane": ".crane",
    "CraneError": ".errors",
    "ExudynEngine": ".engine",
    "linearise": ".linearised",
    "load_effects": ".effects.registry",
    "Recording": ".recording",
    "simulate": ".simulation",
}
__all__ = ["Crane", "CraneError", "ExudynEngine", "Recording", "linearise", "load_effects", "simulate"]
__getattr__ = lazily(__name__, _WHERE)
