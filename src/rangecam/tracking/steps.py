"""One step of all tracks (König 2008, section 6.4.3): the kernels that `update` calls, once for a frame."""

import numpy as np

from rangecam.compiled import kernel
from rangecam.tracking.filter import gate_pairs, mixture, take_only_candidates, update
from rangecam.tracking.interacting import predict_modes, update_modes
from rangecam.tracking.living import live
from rangecam.tracking.moving import drift, predict, predict_turning, turning_room
from rangecam.tracking.rules import PAIRED, PAIRING
from rangecam.tracking.sighting import complete, ends, unseen, wander
from rangecam.types import MEMORY, Floats, Ints

_NOISE = MEMORY.index("process_noise")
Outcome = tuple[bool, int, int, int, int]
"""Whether the step is done; if so, as of `living.live`: how many tracks end, how many finite segments are left over,
how many tracks that are not tentative took none, how many segments are not finite."""


@kernel
def follow(
    state: Floats,
    covariance: Floats,
    status: Ints,
    age: Ints,
    hits: Ints,
    misses: Ints,
    extent: Floats,
    near_offset: Floats,
    n_pixels: Floats,
    class_probability: Floats,
    memory: Floats,
    label: Ints,
    position: Floats,
    position_covariance: Floats,
    size: Floats,
    near: Floats,
    pixels: Ints,
    box: Ints,
    range_m: Floats,
    amplitude: Floats,
    sigma: Floats,
    cut: Ints,
    sides: Floats,
    model: Floats,
    rules: Floats,
    own: Floats | None,
    dt_s: float,
    x: Floats,
    P: Floats,
    counts: Ints,
    means: Floats,
    new_extent: Floats,
    new_memory: Floats,
    cost: Floats,
    took: Ints,
    weights: Floats | None,
    stage: int,
) -> Outcome:
    """Predict, gate, associate, update, age and take the shapes of the segments in, unless tracks or segments compete.

    Given one by one, as a tuple of arrays costs a call more than what is done with them: fields of the tracks, and of
    the segments as in `Seen`; F and Q of one axis (2, 3, 3), `RULES`, own velocity (2,) if the model turns. None is a
    type of its own, for which Numba leaves out what is not needed: so the first use comes sooner.

    Written: x (N, 9), P (N, 9, 9); counts (5, N), means (3, N), new_extent (N, 3), new_memory: see `living.live`; took
    (N,): index of the segment, -1 for none. Where tracks or segments compete, x and P are the prediction, and the cost
    (N, M) of each pairing is written: fill in took, and weights (N, M) if tracks take several by their probabilities,
    and call once more: `PAIRED`.
    """
    seen = label, position, size, near, pixels, box, range_m, amplitude, sigma, cut, sides
    R = np.empty_like(position_covariance)
    complete(position_covariance, size, cut, rules, R)
    if stage != PAIRED:
        shares = rules[21], rules[5]
        if own is not None:
            room = turning_room()
            for i in range(len(x)):
                predict_turning(state[i], covariance[i], model, shares, memory[i, _NOISE], own, x[i], P[i], room)
        else:
            for i in range(len(x)):
                predict(state[i], covariance[i], model, shares, memory[i, _NOISE], x[i], P[i])
        lasting = drift(model[0, 0, 1], rules)
        for i in range(len(x) if lasting > 0 else 0):
            for a in (0, 3, 6):
                P[i, a, a] += lasting
    unseen(x, P, memory, (position, size, cut), rules, R, True)
    end = ends(position_covariance, (size, pixels, cut, sides), rules, R)
    measured = position, R, rules[3], pixels, end, memory, wander(memory, rules[18]), rules[4]
    if stage != PAIRED:
        gate_pairs(x, P, measured, rules[0], rules[13], cost)
        if not take_only_candidates(cost, misses, rules[22] > 0, took) or stage == PAIRING:
            return False, 0, 0, 0, 0
    update(x, P, took, weights, measured, means[2])
    before = status, age, hits, misses, extent, near_offset, n_pixels, class_probability, memory
    motion, new = (state, x, P), (counts, means, new_extent, new_memory)
    return live(before, seen, position_covariance, rules, dt_s, took, motion, new)


@kernel
def follow_modes(
    mode_probability: Floats,
    mode_state: Floats,
    mode_covariance: Floats,
    state: Floats,
    status: Ints,
    age: Ints,
    hits: Ints,
    misses: Ints,
    extent: Floats,
    near_offset: Floats,
    n_pixels: Floats,
    class_probability: Floats,
    memory: Floats,
    label: Ints,
    position: Floats,
    position_covariance: Floats,
    size: Floats,
    near: Floats,
    pixels: Ints,
    box: Ints,
    range_m: Floats,
    amplitude: Floats,
    sigma: Floats,
    cut: Ints,
    sides: Floats,
    models: Floats,
    switching: Floats,
    turns: Floats,
    rules: Floats,
    own: Floats | None,
    dt_s: float,
    mu: Floats,
    modes: Floats,
    spreads: Floats,
    x: Floats,
    P: Floats,
    counts: Ints,
    means: Floats,
    new_extent: Floats,
    new_memory: Floats,
    cost: Floats,
    took: Ints,
    weights: Floats | None,
    stage: int,
) -> Outcome:
    """Do what `follow` does for an interacting multiple model.

    Given besides: F and Q of each mode (K, 2, 3, 3), probabilities of switching (K, K), whether each turns (K,).
    Written besides: probability (N, K), state (N, K, 9) and covariance (N, K, 9, 9) of the modes; x and P are their
    mean.
    """
    seen = label, position, size, near, pixels, box, range_m, amplitude, sigma, cut, sides
    R = np.empty_like(position_covariance)
    complete(position_covariance, size, cut, rules, R)
    if stage != PAIRED:
        old, new = (mode_probability, mode_state, mode_covariance), (mu, modes, spreads)
        predict_modes(old, (models, switching, turns), ((rules[21], rules[5]), memory), own, new)
        lasting = drift(models[0, 0, 0, 1], rules)
        for i in range(len(x)):
            for k in range(mu.shape[1] if lasting > 0 else 0):
                for a in (0, 3, 6):
                    spreads[i, k, a, a] += lasting
            mixture(mu[i], modes[i], spreads[i], x[i], P[i])
    unseen(x, P, memory, (position, size, cut), rules, R, True)
    end = ends(position_covariance, (size, pixels, cut, sides), rules, R)
    measured = position, R, rules[3], pixels, end, memory, wander(memory, rules[18]), rules[4]
    if stage != PAIRED:
        gate_pairs(x, P, measured, rules[0], rules[13], cost)
        if not take_only_candidates(cost, misses, rules[22] > 0, took) or stage == PAIRING:
            return False, 0, 0, 0, 0
    update_modes((mu, modes, spreads), (x, P), took, weights, measured, means[2])
    before = status, age, hits, misses, extent, near_offset, n_pixels, class_probability, memory
    new_tracks = counts, means, new_extent, new_memory
    return live(before, seen, position_covariance, rules, dt_s, took, (state, x, P), new_tracks)
