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
    level: float = 1.04  # error below which hardly more than noise is left
    doubt: float = 4.0  # or below one and so many standard errors of the noise, where it is estimated from few samples
    shared: float = 0.04  # s within which the noise of neighbouring samples is alike; what lasts longer is the model's
    shared_at_last: float = 0.25  # largest part that samples so far apart share, for what is left to be noise
    scattered: float = 3.0  # standard errors of the noise by which it may scatter between distances of samples
    share: float = 0.03  # of short windows a good model may leave unexplained; noise makes fewer than one in a hundred
    explained: float = 1.3  # error up to which a window counts as explained
    explained_errors: float = 4.0  # or up to one and so many of its standard errors, where its samples are few
    # chance of all moves of parameters together below which they are not believed: no rough uncertainty makes it
    implausible: float = 1e-9
    far: float = 2.0  # moves beyond this count as far; parameters alone with
    several: int = 2  # so many far moves are no whole explanation
    helped: float = 5.0  # log prior of moves from which on they do an effect's work; right effects rarely cost that
    told_apart: float = 3.0  # standard deviations from neutral; below, the model is fitted without the effect as well
    undetermined: float = 1e3  # standard deviation in typical sizes from which on the data say nothing
    at_end: float = 1e-3  # typical sizes from an end of its range, or from neutral, within which a parameter is there
    lost: float = 1.3  # a run is so many times worse than its short windows only if its start went astray
    clock: float = 0.1  # share of what an effect does to commands that a shift of their clock may leave
    shifts: int = 20  # shifts of the clock that are tried within a sampling interval
    moved: float = 0.1  # standard uncertainties from which on a parameter is listed as moved

    # what is believed before the data, and how far fits follow them
    plausible: float = 3.0  # standard deviation of an effect's parameter, in sizes that are met in practice
    broad: float = 2.0  # standard deviation of u of a variable that has no prior of its own
    informed: float = 0.2  # share of its prior variance that a combination of parameters must lose to be moved
    off: float = 2.0  # median error of short windows from which on a load is begun over its whole range
    caught: float = 1.3  # error of a window from which on its first state may be caught in a false minimum
    elsewhere: float = 0.6  # s, length of windows that are cut elsewhere, where some stay unexplained

    # what a move must bring
    proof: float = 12.0  # log evidence over the best model with fewer effects: 1 in 150 000 by chance
    tie: float = 6.0  # log evidence within which two models are not told apart: 400 to 1
    shown: float = 18.0  # log evidence within which a candidate's open-loop errors are computed: three ties
    promise: float = 1.0  # fall of the cost that the screen must expect where much is left; a `tie` where little is
    # share of the excess squared error that a further effect may leave: many make good a little of a nearly right law
    left: float = 0.5
    repaired: float = 0.8  # share of the windows whose repair explains all the same
    left_level: float = 1.3  # if no more than this level is left
    # share of the excess that may be left: on blocks left out, where a chamber boils and spoils a stretch; and for an
    # effect that no screen sees to have nothing to explain
    left_of_rest: float = 0.05
    misled: float = 2.0  # error on the check recording from which on it was not predicted, and level of lost cases
    let_go: float = 2.0  # log evidence that a nominal parameter must bring to move in the lean explanation: 7 to 1
    freed: int = 10  # parameters that the lean explanation may free at first
    freed_again: int = 4  # and once more, where these have found their places

    # how far is searched
    most: int = 2  # effects that are looked for where much is left: for three there are too many combinations
    beam: int = 3  # models that a round goes on from
    singles: int = 7  # effects that are fitted to the crane without effects
    others: int = 5  # effects that are fitted beside each model of a beam
    nearly: int = 2  # effects that are fitted beside a model that leaves hardly more than noise
    as_given: int = 3  # effects seen from the machine as given that are fitted where parameters may do an effect's work
    finished: int = 2  # fits carried to the end
    near: float = 0.3  # share of the best one's gain that one more fit may lack to be carried to the end
    apart: float = 100.0  # log evidence within which rivals are always fitted, and carried to the end
    first: int = 2  # moves that are fitted before the others, if they promise most
    sifted: int = 3  # iterations after which a fit must have its `chance` to go on
    chance: float = 0.25  # share of what the best brings by then that lets a fit go on
    hopeless: float = 0.02  # share of the best promise below which a start is not fitted
    sure: int = 3  # starts that are fitted however little they promise
    twice: float = 0.5  # share of the best promise from which on an effect is fitted from two starts: for two minima
    smallest: float = 0.02  # amplitude of the screen, in sizes that are met in practice, below which nothing is there
    largest: float = 20.0  # amplitude beyond which the linear look says nothing
    moments: float = 0.5  # s between the moments at which an effect with a time of its own is tried
    closer: float = 0.035  # s between those around the best of them: a quarter of the period of a ring of 7 Hz
    moments_at_most: float = 120.0  # moments in a long recording, which would take minutes to screen
    further: int = 2  # leading fits that are taken further where they are not at their end
    learned: float = 0.625  # share of each recording that is learned from where a choice is judged on the rest

    # where errors drift and levels follow the model
    window: float = 2.0  # s: a ring dies out, and a metering law shows; in a quarter of a second they do not
    joined: float = 100.0  # how many times smaller than usual the jumps between such windows are
    independent: float = 0.25  # s after which errors in windows are taken as independent at the latest
    drifts: float = 1.0  # s after which errors in a run over the whole recording are
    settled: int = 3  # how often the last fit takes up the error levels that it leaves: they hardly change after that
    demanded: float = 5.0  # log evidence of independent samples that an effect must bring
    serious: float = 0.5  # share of the best one's evidence from which on others are run over whole recordings
    # log by which open-loop errors must fall, learned and left out together, as a surrogate makes them fall by less;
    # two falls that differ by less are alike
    gained: float = 0.1
    part: float = 0.25  # share of the log that is left that does as well: of four missing effects the best takes that
    tolerated: float = 0.1  # log by which errors on what was left out may rise
    mended: float = 1.5  # an effect stays if some channel's error is so many times as large without it
    worse: float = 1.05  # ratio of a channel's errors from which on it is reported as worse
    believed: float = 3.0  # bound of parameters' moves in the last fit
    doubted: float = 2.9  # move from which on a parameter is reported as doubted
    reported: float = 1.0  # move from which on a parameter is reported at all
    alike: float = 0.9  # correlation from which on two variables are said not to be separated
    tried: int = 9  # effects that are fitted in a round, from several sides
    rounds: int = 2  # rounds; what they missed is looked for where all is fitted together
    begun: int = 4  # iterations of each start
    ended: int = 8  # further iterations of those that have a `chance`
    worth: float = 0.1  # share by which what was not fitted must be predicted better

    # what is learned
    laws: int = 2  # laws beside each other
    screened: int = 4  # laws that are fitted in loosely joined windows
    beside: int = 3  # effects of the library that are fitted beside them
    carried: int = 2  # laws that are carried to the end, with the best effect of the library
    predicts: float = 0.4  # share of what a law gains where it was fitted that it must gain where it was not
    astray: float = 3.0  # standard deviations by which a curve may fall below what physics allows
    below: float = 0.1  # share of its largest value by which it may in any case
    knots: int = 9  # knots of a curve
    seldom: float = 0.002  # share of the visited instants on either side that a curve's range leaves out
    ranging: float = 0.02  # least range of a curve, as a share of what is met in practice
    block: float = 1.5  # s that are left out in turn; what was met within less than one predicts no other
    known: float = 0.1  # share of its greatest departure up to whose standard deviation an end of a curve is known
    onward: float = 0.5  # share of what is known by which it goes on along its form beyond either end
    form_errors: float = 2.0  # standard errors that a form may leave of a curve that it names
    form_share: float = 0.08  # or share of the curve's greatest departure
    formed: int = 6  # fits of a form at most, each from where the last one came to

    # what an improvement says of its steps
    agreement: float = 0.05  # share by which the two engines' errors may differ before it is reported


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
