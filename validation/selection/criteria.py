"""Every threshold of the search, with its reason. Where they come from: docs/calibration.md."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Criteria:
    """Thresholds; logs are natural, levels and errors in units of the sensors' noise, moves in standard uncertainties.

    What is said of a model:
        level: below it hardly more than noise is left; noise that is estimated is itself wrong by 2 %.
        share: at most this share of short windows stays unexplained by such a model; noise alone makes none in a hundred.
        explained: error up to which a window counts as explained; four standard errors where its samples are few.
        implausible: probability of all moves of parameters together below which they are beyond their uncertainties; a crane file's
            uncertainties are rough, so only what no roughness makes is refused.
        far, several: so many moves beyond so many standard uncertainties are too many for parameters to be the whole explanation.
        helped: log prior that moved parameters cost from which on they do an effect's work; right effects rarely cost that.
        told_apart: an effect acts if its parameters are so many standard deviations from neutral.

    What a move must bring:
        proof: log evidence over the best model with fewer effects: four parameters' worth of chance at one in 150 000.
        tie: log evidence within which two models are not told apart (400 : 1).
        promise: fall of the cost that the screen must expect where much is left (where little is left: `proof`).
        left: share of the excess squared error that a further effect may leave; a law that is only nearly the machine's leaves a little that can be
            told from noise, and many an effect makes some of it good.
        repaired, left_level: what leaves something explains all the same if it repairs this share of the windows and leaves this level.
        left_of_rest: what leaves more still explains if on blocks that it was not fitted to it leaves no more than this share of the excess squared
            error, and `left_level`: a chamber that boils spoils the stretch in which it boils.
        misled: error on the check recording from which on a model has not predicted it.

    How far is searched:
        beam: how many models a round goes on from.
        singles, others, nearly, as_given: moves that are fitted from the crane without effects, from each model of a beam, from one that leaves hardly
            more than noise, and, where parameters may do an effect's work, from the machine as given.
        finished: fits of a round that are carried to the end; one more if it lacks no more than `near` of the best one's gain.
        hopeless: share of the best promise below which a start is not fitted.
        further: how many leading fits that are not at their end are taken further.
        learned: share of each recording that is learned from where a choice is judged on the rest.

    Where errors drift and the levels follow the model:
        demanded: log evidence of independent samples that an effect must bring; serious: share of the best one's from which on others are run.
        gained: log by which open-loop errors, learned and left out, must fall; tolerated: by which those left out may rise.
        mended: an effect stays, for all its evidence, if some channel's error is so many times as large without it.
        believed, strained, told: standard uncertainties within which parameters are held at last, from which they are doubted, and told.
        tried: effects that are fitted in a round.
        worth: share by which what was not fitted must be predicted better for effects to be written.
    """

    level: float = 1.04
    share: float = 0.03
    explained: float = 1.3
    implausible: float = 1e-9
    far: float = 2.0
    several: int = 2
    helped: float = 5.0
    told_apart: float = 3.0

    proof: float = 12.0
    tie: float = 6.0
    promise: float = 1.0
    left: float = 0.5
    repaired: float = 0.8
    left_level: float = 1.3
    left_of_rest: float = 0.05
    misled: float = 2.0

    beam: int = 3
    singles: int = 7
    others: int = 5
    nearly: int = 2
    as_given: int = 3
    finished: int = 2
    near: float = 0.3
    hopeless: float = 0.02
    further: int = 2
    learned: float = 0.625

    demanded: float = 5.0
    serious: float = 0.5
    gained: float = 0.1
    tolerated: float = 0.1
    mended: float = 1.5
    believed: float = 3.0
    strained: float = 2.9
    told: float = 1.0
    tried: int = 9
    worth: float = 0.1


CRITERIA = Criteria()
