"""Every threshold of the search, with its reason. On what each was set: docs/calibration.md."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Criteria:
    """Thresholds; logs are natural, levels and errors in units of the sensors' noise, moves in standard
    uncertainties.
    """

    # what is said of a model
    level: float = 1.04  # below it hardly more than noise is left: noise that is estimated is itself wrong by 2 %
    share: float = (
        0.03  # of short windows stay unexplained by such a model; noise alone makes fewer than one in a hundred
    )
    explained: float = (
        1.3  # error up to which a window counts as explained; four standard errors where its samples are few
    )
    implausible: float = (
        1e-9  # chance of all moves of parameters together; stated uncertainties are rough, this no roughness makes
    )
    far: float = 2.0  # moves beyond this, and so many of them, are too many for parameters to be the whole explanation
    several: int = 2
    helped: float = (
        5.0  # log prior of moved parameters from which on they do an effect's work; right effects rarely cost that
    )
    told_apart: float = 3.0  # standard deviations from neutral; below, the model is fitted without the effect as well

    # what a move must bring
    proof: float = 12.0  # log evidence over the best model with fewer effects: 1 in 150 000 by chance
    tie: float = 6.0  # log evidence within which two models are not told apart: 400 to 1
    promise: float = (
        1.0  # fall of the cost that the screen must expect where much is left; where little is left it is `proof`
    )
    # share of the excess squared error that a further effect may leave: many make good a little of a law that is nearly
    # right
    left: float = 0.5
    repaired: float = 0.8  # what leaves something explains all the same if it repairs this share of the windows
    left_level: float = 1.3  # and leaves this level
    left_of_rest: float = (
        0.05  # or this share of the excess on blocks left out: a chamber that boils spoils the stretch where it boils
    )
    misled: float = 2.0  # error on the check recording from which on it was not predicted, and level of lost cases

    # how far is searched
    beam: int = 3  # models that a round goes on from
    # effects that are fitted to the crane without effects, beside each model of a beam, beside one that leaves hardly
    singles: int = 7
    others: int = 5  # more than noise, and, where parameters may do an effect's work, from the machine as given
    nearly: int = 2
    as_given: int = 3
    finished: int = (
        2  # fits that are carried to the end, one more if it lacks no more than `near` of the best one's gain
    )
    near: float = 0.3
    apart: float = 100.0  # log evidence within which rivals are always fitted, and carried to the end
    first: int = 2  # moves that are fitted before the others, if they promise most
    hopeless: float = 0.02  # share of the best promise below which a start is not fitted
    further: int = 2  # leading fits that are taken further where they are not at their end
    learned: float = 0.625  # share of each recording that is learned from where a choice is judged on the rest

    # where errors drift and levels follow the model
    demanded: float = 5.0  # log evidence of independent samples that an effect must bring
    serious: float = 0.5  # share of the best one's from which on others are run over whole recordings
    # log by which open-loop errors must fall, learned and left out together: less is a surrogate's, and two falls that
    gained: float = 0.1  # differ by less are alike
    part: float = 0.25  # or by this share of the log that is left: of four effects that are missing the best takes that
    tolerated: float = 0.1  # log by which those left out may rise
    mended: float = (
        1.5  # an effect stays, for all its evidence, if some channel's error is so many times as large without it
    )
    believed: float = 3.0  # parameters are held within this at last,
    doubted: float = 2.9  # doubted from this on
    told: float = 1.0  # and told from this on
    tried: int = 9  # effects that are fitted in a round
    worth: float = 0.1  # share by which what was not fitted must be predicted better


CRITERIA = Criteria()
