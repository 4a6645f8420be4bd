"""What a model is worth: how well it predicts, where it fails, what it lacks, and what mends it.

    from validation import compare, diagnose, improve, learn

Names are imported when they are first asked for, so that `import validation` costs nothing.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from crane_exudyn.lazily import lazily

if TYPE_CHECKING:
    from .comparison import compare as compare
    from .diagnosis import diagnose as diagnose
    from .improvement import improve as improve
    from .learning import learn as learn
    from .report import write_report as write_report

_WHERE = {
    "compare": ".comparison",
    "diagnose": ".diagnosis",
    "improve": ".improvement",
    "learn": ".learning",
    "write_report": ".report",
}
__all__ = ["compare", "diagnose", "improve", "learn", "write_report"]
__getattr__ = lazily(__name__, _WHERE)
