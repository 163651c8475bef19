"""Tables of the ablations: what being without each effect changes, beyond chance, and what is earned."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.stats import t as student

from ablation_effects import EFFECTS, FULL

CHANCE = 200  # once in so many: of the some hundred cells of all tables, two are bold by chance
WORTH_A_WORD = 0.02  # of the logarithm of an error
HORIZONTAL = ("velocity", "relative", "roll", "pitch", "yaw", "track", "position", "arm", "latency")
HEADINGS = ("velocity", "1 s position", "roll", "pitch", "yaw", "track", "position", "arm", "latency")
SIGMAS = {"velocity": ("vel_north", "vel_west"), "position": ("pos_north", "pos_west"), "yaw": ("yaw",)}


@dataclass(frozen=True)
class Result:
    """One case with one effect off. errors: by quantity, or by block of a recording; scaled: rms error over sigma.

    Both are empty when the estimate had no solution.
    """

    group: str
    case: str
    effect: str
    errors: dict[str, float]
    scaled: dict[str, float]


@dataclass(frozen=True)
class Change:
    """Mean and standard error of the logarithm of error without over error with an effect, of `count` pairs."""

    mean: float
    error: float
    count: int

    @staticmethod
    def of(off: Sequence[float], on: Sequence[float]) -> "Change":
        """Return the change of paired errors."""
        ratios = np.log(np.asarray(off) / np.asarray(on))
        spread = float(np.std(ratios, ddof=1)) if len(ratios) > 1 else np.nan
        return Change(float(np.mean(ratios)), spread / np.sqrt(len(ratios)), len(ratios))

    @property
    def costs(self) -> bool:
        """Whether being without costs more than chance."""
        return self.count > 2 and self.mean > max(student.ppf(1.0 - 1.0 / CHANCE, self.count - 1) * self.error, 0.002)

    @property
    def leans(self) -> bool:
        """Whether being without seems to cost something, though not more than chance may do."""
        return self.count > 2 and self.mean > max(2.0 * self.error, WORTH_A_WORD)

    @property
    def gains(self) -> bool:
        """Whether being without is better than chance."""
        return Change(-self.mean, self.error, self.count).costs

    def __str__(self) -> str:
        text = f"{_percent(self.mean)} ± {100.0 * self.error:.1f}"
        return f"**{text}**" if self.costs else f"*{text}*" if self.gains else text


def _percent(logarithm: float) -> str:
    value = 100.0 * (np.exp(logarithm) - 1.0)
    return f"{value:+.1f}" if abs(value) < 100.0 else f"{value:+.0f}"


def report(results: Sequence[Result]) -> str:
    """Return all tables as Markdown, and which effects nothing shows to be worth having."""
    by_key = {(r.group, r.case, r.effect): r for r in results}
    groups = list(dict.fromkeys(r.group for r in results))
    simulated = [g for g in groups if any("velocity" in r.errors for r in results if r.group == g)]
    changes: dict[str, dict[str, Change]] = {}
    out = []
    for group in simulated:
        names = sorted({r.case for r in results if r.group == group and r.effect == FULL.name})
        out += [f"\n### {group}\n", *_simulated_table(group, names, by_key, changes)]
    if len(simulated) > 1:
        out += ["\n### All simulated sessions together\n", *_pooled_table(simulated, results, by_key, changes)]
    if rest := [g for g in groups if g not in simulated]:
        out += ["\n### Recordings\n", *_recordings_table(rest, by_key, changes)]
    out += ["\n### What is earned\n", *_verdicts(changes)]
    return "\n".join(out)


Key = tuple[str, str, str]
Changes = dict[str, dict[str, Change]]


def _simulated_table(group: str, names: Sequence[str], by_key: dict[Key, Result], changes: Changes) -> list[str]:
    full = [by_key[group, name, FULL.name] for name in names]
    cells = [f"{np.sqrt(np.mean([r.errors[q] ** 2 for r in full])):.3g}" for q in HORIZONTAL]
    lines = [
        f"| without | {' | '.join(HEADINGS)} | error over sigma: {', '.join(SIGMAS)} | sessions |",
        f"|---|{'---:|' * (len(HORIZONTAL) + 2)}",
        f"| everything on: rms, m/s, m, deg | {' | '.join(cells)} | {_scaled(full)} | {len(full)} |",
    ]
    for effect in EFFECTS:
        pairs = [(by_key.get((group, n, effect.name)), f) for n, f in zip(names, full, strict=True)]
        known = [(off, on) for off, on in pairs if off is not None and off.errors]
        if not known:
            continue
        row = []
        for q, heading in zip(HORIZONTAL, HEADINGS, strict=True):
            both = [(o.errors[q], f.errors[q]) for o, f in known if np.isfinite(o.errors[q] * f.errors[q])]
            if not both:
                row.append("no value")
                continue
            change = Change.of(*zip(*both, strict=True))
            changes.setdefault(effect.name, {})[f"{group}: {heading}"] = change
            row.append(str(change))
        lines.append(f"| {effect.name} | {' | '.join(row)} | {_scaled([o for o, _ in known])} | {len(known)} |")
    return lines


def _pooled_table(
    groups: Sequence[str], results: Sequence[Result], by_key: dict[Key, Result], changes: Changes
) -> list[str]:
    lines = [f"| without | {' | '.join(HEADINGS)} | sessions |", f"|---|{'---:|' * (len(HORIZONTAL) + 1)}"]
    for effect in EFFECTS:
        offs = [r for r in results if r.effect == effect.name and r.group in groups and r.errors]
        pairs = [(off, by_key[off.group, off.case, FULL.name]) for off in offs]
        row = []
        for q, heading in zip(HORIZONTAL, HEADINGS, strict=True):
            both = [(o.errors[q], f.errors[q]) for o, f in pairs if np.isfinite(o.errors[q] * f.errors[q])]
            if both:
                change = Change.of(*zip(*both, strict=True))
                changes.setdefault(effect.name, {})[f"all: {heading}"] = change
            row.append(str(change) if both else "no value")
        if pairs:
            lines.append(f"| {effect.name} | {' | '.join(row)} | {len(pairs)} |")
    return lines


def _scaled(results: Sequence[Result]) -> str:
    known = [q for q in SIGMAS if all(q in r.scaled for r in results)]
    return ", ".join(f"{np.sqrt(np.mean([r.scaled[q] ** 2 for r in results])):.2f}" for q in known)


def _recordings_table(groups: Sequence[str], by_key: dict[Key, Result], changes: Changes) -> list[str]:
    def result(group: str, effect: str) -> Result | None:
        return next((r for (g, _, e), r in by_key.items() if g == group and e == effect), None)

    full = {g: found for g in groups if (found := result(g, FULL.name)) is not None}
    cells = [f"{np.sqrt(np.mean(np.square(list(r.errors.values())))):.3f} m" for r in full.values()]
    lines = [f"| without | {' | '.join(full)} |", f"|---|{'---:|' * len(full)}"]
    lines.append(f"| everything on: rms at dropped fixes | {' | '.join(cells)} |")
    for effect in EFFECTS:
        row = []
        for group, on in full.items():
            off = result(group, effect.name)
            if off is None or not off.errors:
                row.append("" if off is None else "no solution")
                continue
            change = Change.of(list(off.errors.values()), list(on.errors.values()))
            changes.setdefault(effect.name, {})[group] = change
            row.append(str(change))
        if any(row):
            lines.append(f"| {effect.name} | {' | '.join(row)} |")
    return lines


def _verdicts(changes: Changes) -> list[str]:
    lines = []
    for effect, found in changes.items():
        costs = sorted((c.mean, where) for where, c in found.items() if c.costs)
        gains = sorted((c.mean, where) for where, c in found.items() if c.gains)
        leans = sorted((c.mean, where) for where, c in found.items() if c.leans and not c.costs)
        if costs:
            verdict = f"earned: without, {_percent(costs[-1][0])} % at {costs[-1][1]}; {len(costs)} cells"
        elif leans:
            verdict = f"likely, on too few cases to be sure: without, {_percent(leans[-1][0])} % at {leans[-1][1]}"
        else:
            verdict = "**not shown to be earned**"
        if gains:
            verdict += f"; better without at {', '.join(f'{where} ({_percent(mean)} %)' for mean, where in gains)}"
        lines.append(f"- {effect}: {verdict}")
    return lines
