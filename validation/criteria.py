"""Every threshold of the search, with its reason. On what each was set: docs/calibration.md."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any


@dataclass(frozen=True)
class Criteria:
    """Thresholds; logs are natural, levels and errors in units of the sensors' noise, moves in standard
    uncertainties.
    """

    # what is said of a model
    level: float = 1.04  # below it hardly more than noise is left, or below one and
    doubt: float = 4.0  # so many standard errors of the noise, where it is estimated from few samples
    share: float = 0.03  # of short windows such a model may leave unexplained; noise makes fewer than one in a hundred
    explained: float = 1.3  # error up to which a window counts as explained, or
    explained_errors: float = 4.0  # so many standard errors where its samples are few
    # chance of all moves of parameters together: stated uncertainties are rough, this no roughness makes
    implausible: float = 1e-9
    far: float = 2.0  # moves beyond this, and so many of them, are too many for parameters to be the whole explanation
    several: int = 2
    helped: float = 5.0  # log prior of moves from which on they do an effect's work; right effects rarely cost that
    told_apart: float = 3.0  # standard deviations from neutral; below, the model is fitted without the effect as well
    undetermined: float = 1e3  # standard deviation in typical sizes from which on the data say nothing
    at_end: float = 1e-3  # typical sizes from an end of its range, or from neutral, within which a parameter is there
    lost: float = 1.3  # a run is so many times worse than its short windows only if its start went astray
    clock: float = 0.1  # share of what an effect does to commands that a shift of their clock may leave,
    shifts: int = 20  # so many of which are tried within a sampling interval
    moved: float = 0.1  # standard uncertainties from which on a parameter is listed as moved

    # what is believed before the data, and how far fits follow them
    plausible: float = 3.0  # standard deviation of an effect's parameter, in sizes that are met in practice,
    broad: float = 2.0  # and of u of a variable that has no prior of its own
    informed: float = 0.2  # share of its prior variance that a combination of parameters must lose to be moved
    off: float = 2.0  # median error of short windows from which on a load is begun over its whole range
    caught: float = 1.3  # error of a window from which on its first state may be caught in a false minimum
    elsewhere: float = 0.6  # s, length of windows that are cut elsewhere, where some stay unexplained

    # what a move must bring
    proof: float = 12.0  # log evidence over the best model with fewer effects: 1 in 150 000 by chance
    tie: float = 6.0  # log evidence within which two models are not told apart: 400 to 1
    shown: float = 18.0  # and within which a candidate's open-loop errors are computed: three times that
    promise: float = 1.0  # fall of the cost that the screen must expect where much is left, a `tie` where little is
    # share of the excess squared error that a further effect may leave: many make good a little of a nearly right law
    left: float = 0.5
    repaired: float = 0.8  # what leaves something explains all the same if it repairs this share of the windows
    left_level: float = 1.3  # and leaves this level,
    # or this of the excess on blocks left out: where a chamber boils a stretch is spoilt; what leaves no more of all
    left_of_rest: float = 0.05  # excess leaves nothing for what no screen sees
    misled: float = 2.0  # error on the check recording from which on it was not predicted, and level of lost cases
    let_go: float = 2.0  # log evidence that a nominal parameter must bring to move in the lean explanation: 7 to 1;
    freed: int = 10  # so many may at first,
    freed_again: int = 4  # and once more, where these have found their places

    # how far is searched
    most: int = 2  # effects that are looked for where much is left: for three there are too many combinations
    beam: int = 3  # models that a round goes on from
    # effects that are fitted to the crane without effects, beside each model of a beam, beside one that leaves hardly
    singles: int = 7
    others: int = 5  # more than noise, and, where parameters may do an effect's work, from the machine as given
    nearly: int = 2
    as_given: int = 3
    finished: int = 2  # fits carried to the end, one more if it lacks no more than `near` of the best one's gain
    near: float = 0.3
    apart: float = 100.0  # log evidence within which rivals are always fitted, and carried to the end
    first: int = 2  # moves that are fitted before the others, if they promise most
    sifted: int = 3  # iterations after which fits go on only
    chance: float = 0.25  # if they bring this share of what the best brings by then
    hopeless: float = 0.02  # share of the best promise below which a start is not fitted,
    sure: int = 3  # but so many are
    twice: float = 0.5  # and above which an effect is fitted from two starts: its values may have two minima
    smallest: float = (
        0.02  # amplitudes of the screen, in sizes that are met in practice: below, an effect is not there,
    )
    largest: float = 20.0  # and far beyond, the linear look says nothing
    moments: float = 0.5  # s between the moments at which an effect with a time of its own is tried,
    closer: float = 0.035  # and around the best of them: a quarter of the period of a ring of 7 Hz
    moments_at_most: float = 120.0  # in a long recording, which would take minutes to screen
    further: int = 2  # leading fits that are taken further where they are not at their end
    learned: float = 0.625  # share of each recording that is learned from where a choice is judged on the rest

    # where errors drift and levels follow the model
    window: float = 2.0  # s: a ring dies out, and a metering law shows; in a quarter of a second they do not
    joined: float = 100.0  # how many times smaller than usual the jumps between them are
    step: float = 5e-3  # s, longest simulation step: its error is far below what such a model leaves
    independent: float = 0.25  # s after which errors are taken as independent at the latest, in windows,
    drifts: float = 1.0  # and in a run over the whole recording
    settled: int = 3  # how often the last fit takes up the error levels that it leaves: they hardly change after that
    demanded: float = 5.0  # log evidence of independent samples that an effect must bring
    serious: float = 0.5  # share of the best one's from which on others are run over whole recordings
    # log by which open-loop errors must fall, learned and left out together: less is a surrogate's, and two falls that
    gained: float = 0.1  # differ by less are alike
    part: float = 0.25  # or by this share of the log that is left: of four effects that are missing the best takes that
    tolerated: float = 0.1  # log by which those left out may rise
    mended: float = 1.5  # an effect stays if some channel's error is so many times as large without it
    worse: float = 1.05  # and from this on that is told
    believed: float = 3.0  # parameters are held within this at last,
    doubted: float = 2.9  # doubted from this on
    told: float = 1.0  # and told from this on
    alike: float = 0.9  # correlation from which on two variables are said not to be separated
    tried: int = 9  # effects that are fitted in a round, from several sides,
    rounds: int = 2  # of such; what they missed is looked for where all is fitted together
    begun: int = 4  # with so many iterations;
    ended: int = 8  # and with so many more, where they have a `chance`
    worth: float = 0.1  # share by which what was not fitted must be predicted better

    # what is learned
    laws: int = 2  # beside each other
    screened: int = 4  # laws that are fitted in loosely joined windows, beside so many
    beside: int = 3  # effects of the library
    carried: int = 2  # of which so many are carried to the end, with the best effect of the library
    predicts: float = 0.4  # share of what a law gains where it was fitted that it must gain where it was not
    astray: float = 3.0  # standard deviations by which a curve may fall below what physics allows,
    below: float = 0.1  # if that is more than this share of its largest value
    knots: int = 9  # of a curve, over what all but this share of the visited instants
    seldom: float = 0.002  # on either side have met,
    ranging: float = 0.02  # if that is at least so much of the range that is met in practice
    block: float = 1.5  # s that are left out in turn; what was met within less than one predicts no other
    known: float = 0.1  # share of its greatest departure up to whose standard deviation an end of a curve is known
    onward: float = 0.5  # share of what is known by which it goes on along its form beyond either end
    form_errors: float = 2.0  # a form is named that leaves no more than so many standard errors,
    form_share: float = 0.08  # or this share of the curve's greatest departure,
    formed: int = 6  # and is fitted at most so many times, each from where the last one came to

    # what an improvement says of its steps
    agreement: float = 0.05  # share by which the two engines' errors may differ before it is said


CRITERIA = Criteria()


@contextmanager
def other_criteria(**values: Any) -> Iterator[None]:
    """Search with other thresholds inside, in this process."""
    usual = {name: getattr(CRITERIA, name) for name in values}
    try:
        _put(values)
        yield
    finally:
        _put(usual)


def _put(values: dict[str, Any]) -> None:
    for name, value in values.items():
        object.__setattr__(CRITERIA, name, value)


#: shares of its range at which a load is begun
BEGINS = (0.15, 0.5, 0.85)
#: m from where a cylinder stands at first at which a place of its stroke is tried: within what a seal deforms, and far
#: beyond
PLACES = (-0.05, -1e-3, -3e-4, 0.0, 3e-4, 1e-3, 0.05)
