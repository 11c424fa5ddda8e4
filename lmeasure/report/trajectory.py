"""Page of a trajectory: the most important facts, missing samples, the path in space, and everything over time with its faults."""

from collections.abc import Iterable, Sequence
from pathlib import Path

import numpy as np
import plotly.graph_objects as go
from plotly.subplots import make_subplots

from lmeasure.accuracy import AXIS_95, MOST_STRETCHES, Along, Stretch, merged
from lmeasure.certificate import with_u95
from lmeasure.core import WORDS, FloatArray
from lmeasure.report import figures, html
from lmeasure.report.text import axes
from lmeasure.rig import Rig
from lmeasure.text import Cause, Say, decimal, is_of, number, settled, texts
from lmeasure.trajectory import RESTORED_ORIGIN, Trajectory, Vibration

MOST_LINES = 100
"""Most stretches in the table; the pictures show all."""
MARKS = 200
"""Most stretches in space: those that lie closer together share one."""
BANDS = 60
"""Most stretches that are shaded over all pictures; the lane shows all."""
HIDDEN = "legendonly"
"""Until it is clicked: beside its rig a path is too small to be seen."""
AXES = ("#0072b2", "#d55e00", "#009e73")
FAULT, LESS = "#c1272d", "#e69f00"
COLOURS = {"broke": FAULT, "fewer": LESS, "restored": LESS}
TITLE = 43.0
"""Distance of a lane from the one above, with the title between them, in pixels."""


def write_trajectory_page(
    path: Path, name: str, found: Along, rig: Rig | None, *, inputs: Sequence[tuple[str, str]], language: str = "en"
) -> None:
    """Write a self-contained HTML page of the trajectory called name, whole or not at all; inputs: files with their SHA-256."""
    say, kinds = Say(language), _kinds(found, language)
    over_time = {
        "time.bands": _banded(found.trajectory), "time.text": True, "time.turns": not np.isnan(found.rotation_deg).all(),
        "time.thinned": len(found.rows) < len(found.u95_mm),
    }  # fmt: skip
    html.write_page(
        path, "trajectory.html", answer(name, found, rig, say), say,
        summary=trajectory_summary(found, language), kinds=kinds[:MOST_LINES], more=max(0, len(kinds) - MOST_LINES),
        restored=any(map(_restored, found.stretches)), known=list(_known(found, language)), inputs=inputs,
        over_time=" ".join(say(f"trajectory.{key}") for key, there in over_time.items() if there),
        plots={"time": figures.figure(time_figure(found, language), "time", language)},
    )  # fmt: skip


def answer(name: str, found: Along, rig: Rig | None, say: Say) -> html.Answer:
    """Return the first screen: whether every sample has a pose, the worst uncertainty and its reason, and the next step."""
    words, number, trajectory = texts(say.language, "trajectory"), say.number, found.trajectory
    samples, time_s = len(found.u95_mm), found.trajectory.time_s
    bad = sum(s.samples for s in found.stretches if not s.ok)
    shown = {"space.text": True, "space.colour": found.worst is not None, "space.rig": rig is not None}
    rows = [html.Number(words["ok"], say("page.of", n=samples - bad, of=samples), "", "warn" if bad else "")]
    limits = say("trajectory.limited_unknown")
    if (i := found.worst) is not None:
        span = say("calibration.mm_from_to", low=float(np.nanmin(found.u95_mm)), high=float(found.u95_mm[i]))
        rows.insert(0, html.Number(say("trajectory.u95_place"), span, say("trajectory.best_worst")))
        place = say.numbers(trajectory.poses[i, :3], ".1f")
        rows += html.assumed_numbers(trajectory.assumed.lines, say)
        limits = say("trajectory.limited_place", time=number(settled(time_s[i]), ".6g"), place=place)
        if np.isfinite(angle := trajectory.worst_pressure_angle_deg[i]):
            limits += " " + say("trajectory.limited_angle", angle=float(angle))
    if not np.isnan(found.u95_rad).all():
        rows.append(html.Number(words["worst.turn"], f"{number(float(np.degrees(np.nanmax(found.u95_rad))), '.3g')}°"))
    if found.motion is not None:
        rows.append(html.Number(words["speed"], _speed(found, say.language)))
    return html.Answer(
        words["title"].format(name=name), *_verdict(found, rig, say), tuple(rows), limits, _steps(name, found, bad, say),
        figures.figure(space_figure(found, rig, say.language), "space", say.language, hero=True),
        say("trajectory.subject", samples=samples, seconds=float(time_s[-1] - time_s[0])),
        " ".join(words[key] for key, there in shown.items() if there),
    )  # fmt: skip


def _verdict(found: Along, rig: Rig | None, say: Say) -> tuple[str, str]:
    """Return one sentence with missing parts, if any, and its state."""
    samples = len(found.u95_mm)
    if bad := sum(s.samples for s in found.stretches if not s.ok):
        return say("trajectory.verdict.bad", bad=bad, samples=samples, percent=say.number(100 * bad / samples, ".3g")), "bad"
    if fewer := sum(s.samples for s in found.stretches):
        return say(f"trajectory.verdict.{'restored' if all(map(_restored, found.stretches)) else 'fewer'}", fewer=fewer), "warn"
    if found.worst is None:
        return say("trajectory.verdict.unstated"), "warn"
    return say(f"trajectory.verdict.{'whole' if rig is None else 'good'}"), "good"


def _steps(name: str, found: Along, bad: int, say: Say) -> tuple[html.Step, ...]:
    steps = []
    if found.worst is None:
        steps.append(html.Step(say("trajectory.next_state"), f"lmeasure report {name} --u-position-mm 0.05 --out page"))
    if bad:
        steps.append(html.Step(say("trajectory.next_causes"), "lmeasure check-instrument RUN --out check"))
    certify = f"lmeasure certify {name if found.worst is None else 'TRAJECTORY'} --program program.toml --out certificate"
    return (*steps, html.Step(say("trajectory.next_certify"), certify))


def trajectory_summary(found: Along, language: str) -> list[tuple[str, str]]:
    """Names and figures that matter, the first ones of a page or a terminal."""
    words = texts(language, "trajectory")

    def own(value: float, form: str = ".4g") -> str:
        return number(language, settled(value), form)

    trajectory, say = found.trajectory, Say(language)
    time_s, n = trajectory.time_s, len(trajectory.time_s)
    span = float(time_s[-1] - time_s[0])
    bad = sum(s.samples for s in found.stretches if not s.ok)
    rate = words["rate"].format(rate=own(1.0 / float(np.median(np.diff(time_s))))) if n > 1 else ""
    rows = [
        (words["duration"], f"{own(span, '.6g')} {words['s']}"),
        (words["samples"], f"{n}{rate}"),
        (words["ok"], f"{n - bad} ({own(100.0 * (n - bad) / n)} %)"),
    ]
    if found.worst is not None:
        i = found.worst
        at = words["at"].format(time=own(time_s[i], ".6g"), place=say.numbers(trajectory.poses[i, :3], ".1f"))
        rows.append((words["worst.place"], f"{own(1e3 * found.u95_mm[i])} {words['um']}{at}"))
    else:
        rows.append((words["worst.place"], words["not_stated"]))
    if not np.isnan(found.u95_rad).all():
        rows.append((words["worst.turn"], f"{own(np.degrees(np.nanmax(found.u95_rad)))}°"))
    elif np.isnan(trajectory.poses[:, 3]).all():
        rows.append((words["worst.turn"], words["no_turn"]))
    if not np.isnan(trajectory.worst_pressure_angle_deg).all():
        rows.append((words["angle"], f"{own(np.nanmax(trajectory.worst_pressure_angle_deg), '.1f')}°"))
    if found.motion is not None:
        rows.append((words["speed"], _speed(found, language)))
        rows.append((words["path"], f"{own(float(np.nanmax(found.motion.path_mm)), '.6g')} {words['mm']}"))
        rows.extend((words["vibration"].format(axis=v.axis.upper()), _vibration(v, language)) for v in found.motion.vibration)
    else:
        rows.append((words["speed"], words["no_speed"].format(why=found.no_motion)))
    return rows


def _speed(found: Along, language: str) -> str:
    assert found.motion is not None
    speed, u95 = found.motion.largest_speed()
    reported = [decimal(language, one) for one in with_u95(speed, u95)] if u95 > 0.0 else [number(language, settled(speed), ".4g")]
    return f"{' ± '.join(reported)} {texts(language, 'trajectory')['mm/s']}"


def _vibration(v: Vibration, language: str) -> str:
    """Return frequency, amplitude and its velocity with their U95."""
    pairs = {
        "hz": (v.frequency_hz, v.u95_frequency_hz),
        "um": (1e3 * v.amplitude_mm, 1e3 * v.u95_amplitude_mm),
        "speed": (v.speed_mm_s, v.u95_speed_mm_s),
    }
    values = {name: " ± ".join(decimal(language, one) for one in with_u95(*pair)) for name, pair in pairs.items()}
    return texts(language, "trajectory")["vibration.value"].format(**values)


def _kinds(found: Along, language: str) -> list[tuple[str, ...]]:
    """Return the samples without a pose or measured without a cable, by cause."""
    say, second = Say(language), texts(language, "trajectory")["s"]
    kinds: dict[tuple[int, Cause, str], list[Stretch]] = {}
    for s in found.stretches:
        kinds.setdefault((s.status, s.cause, s.cable), []).append(s)
    rows: list[tuple[str, ...]] = []
    for (_, cause, cable), own in sorted(kinds.items(), key=lambda item: -sum(s.samples for s in item[1])):
        first, longest = say.number(own[0].begin_s, ".6g"), say.number(max(s.end_s - s.begin_s for s in own), ".4g")
        counts = str(sum(s.samples for s in own)), str(len(own))
        rows.append((_state(own[0], language), say.message(cause), cable, *counts, f"{first}\u00a0{second}", f"{longest}\u00a0{second}"))
    return rows


def _banded(trajectory: Trajectory) -> bool:
    """Return whether anything states an uncertainty."""
    return bool(np.nanmax(trajectory.u, initial=0.0) > 0.0)


def _restored(s: Stretch) -> bool:
    """Return whether these samples have their poses from all cables, with the origin of one restored."""
    return s.ok and is_of(s.cause, RESTORED_ORIGIN)


def _state(s: Stretch, language: str) -> str:
    """Return the state of a stretch's samples, in words."""
    return texts(language, "trajectory")["restored" if _restored(s) else f"status.{WORDS[s.status]}"]


def _known(found: Along, language: str) -> Iterable[str]:
    """Yield the sources in the uncertainties, and other important facts."""
    words, trajectory, say = texts(language, "trajectory"), found.trajectory, Say(language)
    yield words["covers"].format(covers=say.message(trajectory.covers))
    yield from map(say.sentence, (*trajectory.notes, *trajectory.assumed.lines))
    if found.motion is not None:
        said = words["smoothed"].format(half=number(language, 1e3 * found.motion.half_width_s, ".4g"))
        yield f"{said} {words['smoothed.band']}" if _banded(trajectory) else said
        if np.isfinite(found.motion.highest_hz):
            yield words["highest"].format(highest=number(language, found.motion.highest_hz, ".4g"))
        yield from map(say.sentence, found.motion.stamps.notes)


def space_figure(found: Along, rig: Rig | None, language: str = "en") -> go.Figure:
    """The path coloured by the 95 % radius, where it broke off, and the rig."""
    words, say = texts(language, "trajectory"), Say(language)
    number = say.number
    poses, rows = found.trajectory.poses, found.rows
    figure = go.Figure()
    known = np.flatnonzero(~np.isnan(poses[:, 0]))
    if rig is not None and len(known) and not np.isnan(poses[known[0]]).any():
        look = {"visible": HIDDEN, "legendgroup": words["cables"]}
        ways = figures.cable_ways(rig.cable_rows(), poses[known[0]])
        figures.add_cables(figure, ways, words["cables"], line={"width": 2, "color": "#9aa0a6"}, **look)
        figures.add_points(figure, rig.observation_point, say, showlegend=False, hoverinfo="x+y+z+text", **look)
    x, y, z = poses[rows, :3].T
    u95_um = 1e3 * found.u95_mm[rows]
    line: dict[str, object] = {"width": 6, "color": "#555555"}
    if found.worst is not None:
        bar = {"title": {"text": words["bar"], "side": "top"}} | figures.BAR
        line = {"width": 6, "color": u95_um, "colorscale": "Viridis", "colorbar": bar}
    about = [
        f"{number(t, '.6g')} {words['s']}" + ("" if np.isnan(u) else f"<br>U95 {number(u, '.4g')} {words['um']}")
        for t, u in zip(found.trajectory.time_s[rows], u95_um, strict=True)
    ]
    figure.add_scatter3d(x=x, y=y, z=z, mode="lines", line=line, text=about, hoverinfo="x+y+z+text", name=words["origin"])
    for key in ("broke", "fewer", "restored"):
        own = merged([s for s in found.stretches if _mark(s) == key], float(np.ptp(found.trajectory.time_s)) / MARKS)
        # where the tool was last known before the stretch, or first behind it
        at = [i for s in own if (i := _near(s.first, known)) is not None]
        if at:
            px, py, pz = poses[at, :3].T
            reported = [html.label(about_stretch(s, language)) for s in own]
            figure.add_scatter3d(
                x=px, y=py, z=pz, mode="markers", marker={"size": 4, "color": COLOURS[key], "symbol": "diamond"}, text=reported,
                name=words[key], hoverinfo="text",
            )  # fmt: skip
    scene = axes(say) | {"camera": {"eye": {"x": 1.9, "y": -1.9, "z": 1.2}, "center": figures.CAMERA["center"]}}
    return figure.update_layout(height=720, margin={"l": 0, "r": 0, "t": 30, "b": 135}, scene=scene, legend=figures.LEGEND)


def _mark(s: Stretch) -> str:
    """Return how a stretch is marked: a key of its words and of `COLOURS`."""
    return "restored" if _restored(s) else "fewer" if s.ok else "broke"


def _near(sample: int, known: np.ndarray) -> int | None:
    """The last known sample up to this one, else the first one behind it."""
    if not len(known):
        return None
    k = int(np.searchsorted(known, sample, side="right")) - 1
    return int(known[max(k, 0)])


def _shown(stretches: Sequence[Stretch], found: Along) -> list[Stretch]:
    """Return as many as a picture can distinguish."""
    return merged(stretches, float(np.ptp(found.trajectory.time_s)) / MOST_STRETCHES)


def about_stretch(s: Stretch, language: str) -> str:
    """Status, samples, cause and cable of a stretch in words."""
    samples = f"{s.first}–{s.last}" if s.last > s.first else str(s.first)
    return ", ".join(part for part in (_state(s, language), samples, Say(language).message(s.cause), s.cable) if part)


def time_figure(found: Along, language: str = "en") -> go.Figure:
    """Place, rotation, their uncertainty, pressure angle and speed, one under the other, with every stretch that was left out."""
    words = texts(language, "trajectory")
    trajectory, rows = found.trajectory, found.rows
    time_s, u = trajectory.time_s[rows], trajectory.u[rows]
    lanes: list[tuple[str, list[tuple[str, FloatArray, FloatArray | None]]]] = [
        (words["lane.place"], [(n, trajectory.poses[rows, i], AXIS_95 * u[:, i]) for i, n in enumerate("XYZ")])
    ]
    if not np.isnan(found.rotation_deg).all():
        turned: list[tuple[str, FloatArray, FloatArray | None]] = [
            (n, found.rotation_deg[rows, i], np.degrees(AXIS_95 * u[:, 3 + i])) for i, n in enumerate("XYZ")
        ]
        lanes.append((words["lane.turn"], turned))
    if found.worst is not None:
        lanes.append((words["lane.u_place"], [("U95", 1e3 * found.u95_mm[rows], None)]))
    if not np.isnan(found.u95_rad).all():
        lanes.append((words["lane.u_turn"], [("U95", 1e3 * found.u95_rad[rows], None)]))
    if not np.isnan(trajectory.worst_pressure_angle_deg).all():
        lanes.append((words["lane.angle"], [(words["angle"], trajectory.worst_pressure_angle_deg[rows], None)]))
    if found.motion is not None:
        u_speed = AXIS_95 * found.motion.u_speed_mm_s[rows]
        lanes.append((words["lane.speed"], [(words["speed.one"], found.motion.speed_mm_s[rows], u_speed)]))
    kinds = list(dict.fromkeys((_mark(s), s.status) for s in found.stretches))
    heights = [1.0] * len(lanes) + ([0.16 + 0.14 * len(kinds)] if kinds else [])
    status = words["lane.status_or_restored" if any(map(_restored, found.stretches)) else "lane.status"]
    titles = [title for title, _ in lanes] + ([status] if kinds else [])
    high = 210.0 * sum(heights)
    figure = make_subplots(len(titles), 1, shared_xaxes=True, subplot_titles=titles, vertical_spacing=TITLE / high, row_heights=heights)
    for lane, (_, curves) in enumerate(lanes, 1):
        for i, (name, values, half) in enumerate(curves):
            colour = AXES[i] if len(curves) > 1 else "#30343f"
            _curve(figure, lane, time_s, name, values, half, colour, legend=lane == 1)
    if kinds:
        _lane(figure, len(titles), found, kinds, language)
        _shade(figure, found)
    figure.update_xaxes(title_text=words["axis.time"], row=len(titles), col=1)
    figure.update_annotations(font_size=13, x=0.0, xanchor="left")
    legend = {"orientation": "h", "y": 1.0 + 0.8 * TITLE / high, "yanchor": "bottom", "x": 0.0}
    return figure.update_layout(height=int(130.0 + high), margin={"l": 60, "r": 10, "t": 80, "b": 50}, legend=legend, hovermode="x")


def _curve(
    figure: go.Figure, row: int, time_s: FloatArray, name: str, values: FloatArray, half: FloatArray | None, colour: str, *, legend: bool
) -> None:
    """A line and, where its half width is stated, the band that holds 95 %."""
    if half is not None:
        x, y = _band(time_s, values - half, values + half)
        figure.add_scatter(
            x=x, y=y, mode="lines", line={"width": 0}, fill="toself", fillcolor=_pale(colour), hoverinfo="skip", showlegend=False,
            legendgroup=name, row=row, col=1,
        )  # fmt: skip
    line = {"width": 1.5, "color": colour}
    figure.add_scatter(x=time_s, y=values, mode="lines", line=line, name=name, legendgroup=name, showlegend=legend, row=row, col=1)


def _band(time_s: FloatArray, low: FloatArray, high: FloatArray) -> tuple[list[float | None], list[float | None]]:
    """Outlines of the band between low and high, one for each stretch in which it is known."""
    known = np.flatnonzero(np.isfinite(low) & np.isfinite(high))
    x: list[float | None] = []
    y: list[float | None] = []
    for own in np.split(known, np.flatnonzero(np.diff(known) > 1) + 1):
        if len(own):
            x += [*time_s[own].tolist(), *time_s[own[::-1]].tolist(), None]
            y += [*high[own].tolist(), *low[own[::-1]].tolist(), None]
    return x, y


def _pale(colour: str) -> str:
    red, green, blue = (int(colour[i : i + 2], 16) for i in (1, 3, 5))
    return f"rgba({red},{green},{blue},0.3)"


def _lane(figure: go.Figure, row: int, found: Along, kinds: Sequence[tuple[str, int]], language: str) -> None:
    """Every stretch as a bar on the line of its mark and status, however short."""
    for key, status in kinds:
        own = _shown([s for s in found.stretches if (_mark(s), s.status) == (key, status)], found)
        name = texts(language, "trajectory")[f"status.{WORDS[status]}" if key == "broke" else f"lane.{key}"]
        figure.add_scatter(
            x=[t for s in own for t in (s.begin_s, s.end_s, None)], y=[name, name, None] * len(own), mode="lines+markers",
            line={"width": 9, "color": COLOURS[key]}, marker={"size": 7, "symbol": "line-ns-open", "color": COLOURS[key]},
            text=[html.label(about_stretch(s, language)) for s in own for _ in range(3)], hoverinfo="x+text", showlegend=False,
            row=row, col=1,
        )  # fmt: skip


def _shade(figure: go.Figure, found: Along) -> None:
    """The longest of the stretches without a pose, over all pictures."""
    bad = sorted(_shown([s for s in found.stretches if not s.ok], found), key=lambda s: s.begin_s - s.end_s)[:BANDS]
    look = {"type": "rect", "xref": "x", "yref": "paper", "y0": 0.0, "y1": 1.0, "fillcolor": FAULT, "opacity": 0.12}
    figure.update_layout(shapes=[{**look, "x0": s.begin_s, "x1": s.end_s, "line": {"width": 0.5, "color": FAULT}} for s in bad])
