"""What is wrong with a scene or its simulation, and what there is to doubt in what was found."""

from __future__ import annotations

from collections.abc import Sequence

import mujoco
import numpy as np

from orbisim.diagnosis.conclusion import Attribution
from orbisim.diagnosis.consistency import inconsistency
from orbisim.effects import effect_names, find
from orbisim.effects.flags import disabled_of, impossible
from orbisim.evidence import NEAR
from orbisim.scene import Scene
from orbisim.shooting.bench import Bench
from orbisim.shooting.halving import halving, matters
from orbisim.shooting.judge import Judged
from orbisim.shooting.remainder import told_as_noise
from orbisim.shooting.stepping import stepping
from orbisim.shooting.timestep import typical_interval


def coarse_timestep(bench: Bench, residual: float) -> str | None:
    """A note if free runs of the declared scene with half its timestep differ by what matters: what
    is left is then partly the integrator's, and no effect accounts for it.

    Args:
      residual: of the declared scene, over the noise.
    """
    ratio = halving(bench)
    if not ratio > max(_SHOWS, _PART * residual) or not matters(bench, residual):
        return None
    step = float(bench.scene.model.opt.timestep)
    return (
        f"with half the timestep ({step / 2:g} s instead of {step:g} s) free runs differ by "
        f"{ratio:.3g} times the noise (through impacts: of it and what these leave unknown): the "
        "timestep is too long for these data; shorten it in <option timestep>"
    )


_SHOWS = 1.0
"""Difference over noise, root mean square in a typical window, from which on it matters."""
_PART = 0.3
"""... and share of the residual."""


def restepped(declared: Scene, taken: Scene) -> str | None:
    """A note if another timestep or integrator than the declared one was taken."""
    before, after = stepping(declared), stepping(taken)
    if before == after:
        return None
    return (
        f"free runs with a {after} predict better than with the declared {before}: the "
        "augmented scene has it, and what is named is missing beside that"
    )


def between_samples(bench: Bench) -> str | None:
    """A note if controls were taken to change between samples."""
    if not bench.lead:
        return None
    if bench.lead.clock:
        return (
            "free runs predict surely better where controls change by the clock of their own that "
            "the log shows: when each changes between two samples follows from it (the "
            "free-running errors of this report take a mean of both there)"
        )
    share, interval = bench.lead.share, typical_interval(bench)
    place = "before"
    why = (
        "commands of a slower rate than the log's or beside its clock, or a simulated machine "
        "whose steps apply controls in another order"
    )
    if share < 0:
        place, why = "after", "they arrive late, in the drives or on the way to them"
    return (
        f"free runs predict surely better where controls change {1e3 * abs(share) * interval:.2g} "
        f"ms ({abs(share):.0%} of a sampling interval) {place} the sample at which they are logged "
        f"({why}); the free-running errors of this report take a mean of both between two samples"
    )


def disabled(scene: Scene) -> list[str]:
    """Notes on effects that a disabled flag of the scene makes impossible, or is lifted for."""
    kept = [name for name in effect_names() if impossible(scene.model, find(name).needs)]
    lifted = [name for name in effect_names() if name not in kept and _off(scene, [name])]
    notes = []
    if kept:
        notes.append(
            f"the scene disables {_off(scene, kept)} (<option><flag/>), so that {', '.join(kept)} "
            "can have no effect in it: they were not looked for"
        )
    if lifted:
        notes.append(
            f"the scene disables {_off(scene, lifted)} (<option><flag/>): {', '.join(lifted)} were "
            "looked for with that enabled for them alone, and if one is named, the augmented scene "
            "has it so; all else that the flag keeps off stays off"
        )
    return notes


def _off(scene: Scene, effects: Sequence[str]) -> str:
    """Names of the flags that are set and that these effects need; empty if none is."""
    bits = {bit for name in effects for bit in disabled_of(scene.model, find(name).needs)}
    return ", ".join(sorted(_flag(bit) for bit in bits))


def _flag(bit: mujoco.mjtDisableBit) -> str:
    return bit.name.removeprefix("mjDSBL_").lower()


def doubts(found: Attribution) -> list[str]:
    """Notes on what was found: effects that would have to be others in other motion, a timestep
    that is too long, and impacts."""
    notes: list[str] = []
    if found.after.ratio > NEAR:
        whole = found.bench.whole()
        for number, effect in enumerate(found.hypothesis.effects):
            problem = inconsistency(whole, found.after, number)
            notes += [] if problem is None else [f"{effect.effect} at {effect.target}: {problem}"]
    noise = told_as_noise(found.bench, found.after, found.left)
    notes += [] if noise is None else [noise]
    coarse = coarse_timestep(found.bench, found.before.ratio) if found.before.ratio > NEAR else None
    notes += [] if coarse is None else [coarse]
    if found.rugged and found.after is not found.before:
        notes.append(
            "impacts make the cost rugged: intervals of effects on contacts do not contain that; "
            "other recordings of the same thing may give numbers further apart"
        )
    if found.after is found.before and found.bench.contacts and few_bad(found.before):
        notes.append(bad_windows(found.before))
    return notes


def few_bad(judged: Judged) -> bool:
    """Whether a few windows are bad and the others are not."""
    whole, typical = judged.pooled**2 - 1.0, max(judged.ratio**2 - 1.0, 0.0)
    return whole >= max(_BAD, _FEW_BAD * typical)


_BAD = 0.5
"""Mean square beyond the noise, over all windows, above which some are bad."""
_FEW_BAD = 3.0
"""How many times what windows leave with the worst left out, if few are bad."""


def bad_windows(declared: Judged) -> str:
    """What to say where a few windows are bad and nothing accounts for them."""
    left = np.concatenate([declared.fitted, declared.checked])
    return (
        f"{(left > NEAR**2).sum()} of {len(left)} windows miss by more than {NEAR:g} times the "
        f"noise (up to {np.sqrt(left.max()):.3g} times), the others do not: impacts there may be "
        "hard to reproduce, but an effect that acts in these windows alone would not be seen either"
    )
