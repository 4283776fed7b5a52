"""tool.html, one file: verdict first, then the body, the poses, what is left in time, correlations."""

from html import escape
from pathlib import Path

import numpy as np

from truewrench.model.arrays import Array
from truewrench.model.files import atomic_output
from truewrench.tool.identify import Evidence, exported_body
from truewrench.tool.model import Tool
from truewrench.tool.parameters import ELEMENTS, symmetric
from truewrench.tool.words import correlations

_COLOURS = ("#0072B2", "#D55E00", "#009E73")  # of Okabe and Ito, x y z
_DASHES = ("", "6 3", "2 2")
_STYLE = """body{font:16px/1.5 sans-serif;max-width:60rem;margin:2rem auto;padding:0 1rem;color:#222}
table{border-collapse:collapse}td,th{padding:.2rem .8rem;border-bottom:1px solid #ccc;text-align:right}
td:first-child,th:first-child{text-align:left}.good{color:#00603f}.bad{color:#a03000}
.scroll{overflow-x:auto}figure{margin:1.5rem 0}figcaption{color:#444}svg{max-width:100%;height:auto}"""


def write_page(path: str | Path, tool: Tool, evidence: Evidence) -> None:
    """Write the page; the file appears whole or not at all."""
    with atomic_output(path) as temporary:
        temporary.write_text(_page(tool, evidence), encoding="utf-8", newline="\n")


def _page(tool: Tool, evidence: Evidence) -> str:
    verdict = tool.verdict
    word = "Usable" if verdict.usable else "Not to be used as it stands"
    parts = [
        f'<h1 class="{"good" if verdict.usable else "bad"}">{word}</h1>',
        f"<p>{escape(_of(tool))}</p>",
        _list(verdict.reasons),
        _table(tool),
        "<h2>What the data do not tell</h2>" + _list(one.words for one in verdict.undetermined),
        "<h2>What to do next</h2>" + _list(verdict.needed) if verdict.needed else "",
        _figure(_body(tool), _body_caption(tool)),
    ]
    if len(evidence.solution.problem.poses):
        parts += [
            _figure(
                _sphere(tool, evidence),
                "Directions of gravity in sensor axes, seen along -z (left: the "
                "half with z up, right: down); numbers are the order in time. Open rings: the next best.",
            ),
            *_in_time(tool, evidence),
            _held(tool),
        ]
    parts.append("<h2>What stands and falls together</h2>" + (_list(correlations(tool)) or "<p>Nothing.</p>"))
    policy = (
        "default-src 'none'; style-src 'unsafe-inline'; img-src data:; base-uri 'none'; form-action 'none'"
    )
    return (
        '<!doctype html><html lang="en"><head><meta charset="utf-8"><title>Tool</title>'
        f'<meta http-equiv="Content-Security-Policy" content="{policy}"><style>{_STYLE}</style></head><body>'
        + "\n".join(part for part in parts if part)
        + f"<p>truewrench {escape(tool.version)}, {escape(tool.created)}</p></body></html>\n"
    )


def _of(tool: Tool) -> str:
    """What it was found from, and the frame of every number."""
    logs = ", ".join(Path(str(log["path"])).name for log in tool.logs)
    return (
        f"A tool from {logs}. In the axes of the sensor frame: the centre of mass from its origin, the "
        "inertia about the centre of mass."
    )


def _list(items: object) -> str:
    rows = "".join(f"<li>{escape(str(item))}</li>" for item in items)  # type: ignore[attr-defined]
    return f"<ul>{rows}</ul>" if rows else ""


def _figure(svg: str, caption: str) -> str:
    return f"<figure>{svg}<figcaption>{escape(caption)}</figcaption></figure>"


def _table(tool: Tool) -> str:
    known = tool.determined
    rows = [("mass [kg]", tool.mass, tool.mass_std, known["mass"])]
    if tool.below is not None:
        whole = tool.whole
        rows.append(("mass with what it sits on [kg]", whole.mass, whole.mass_std, known["mass"]))
    for k, axis in enumerate("xyz"):
        rows.append(
            (
                f"centre of mass {axis} [m]",
                tool.center_of_mass[k],
                tool.center_of_mass_std[k],
                known["center_of_mass"][k],
            )
        )
    for k, name in enumerate(ELEMENTS):
        rows.append((f"inertia {name} [kg m²]", tool.inertia[k], tool.inertia_std[k], known["inertia"][k]))
    for k, name in enumerate(("roll", "pitch", "yaw")):
        rows.append((f"mounting {name} [rad]", tool.mounting[k], tool.mounting_std[k], True))
    for k, channel in enumerate(tool.rig.sensor.channels):
        rows.append((f"offset of {escape(channel)} [raw]", tool.offset[k], tool.offset_std[k], True))
    cells = "".join(
        f"<tr><td>{name}</td><td>{value:.5g}</td><td>{std:.2g}</td></tr>"
        if told
        else f"<tr><td>{name}</td><td>not determined</td><td></td></tr>"
        for name, value, std, told in rows
    )
    return f"<table><tr><th></th><th>found</th><th>1 sigma</th></tr>{cells}</table>"


def _body_caption(tool: Tool) -> str:
    size = 1e3 * float(tool.whole.center_of_mass_std.max())
    kind = "assumed: not determined" if tool.exported.inertia_assumed else "of equal inertia"
    return (
        f"What the sensor carries, side views [mm]: the ellipsoid ({kind}) about the centre of mass, whose "
        f"1 sigma is at most {size:.2g} mm (bars: 3 sigma)."
    )


def _body(tool: Tool) -> str:
    """Two side views of the solid ellipsoid of equal inertia: semi-axes^2 = 5 x second moments per mass."""
    whole, of, told = tool.whole, tool.layout.body, not tool.exported.inertia_assumed
    # without the housing, which the sensor does not feel
    carried = exported_body(whole.theta[of], whole.covariance[of, of], told, np.zeros(4))
    inertia, center, std = symmetric(carried.inertia), carried.center_of_mass, whole.center_of_mass_std
    S = (0.5 * np.trace(inertia) * np.eye(3) - inertia) / carried.mass
    values, axes = np.linalg.eigh(S)
    half = (axes * np.sqrt(5.0 * np.maximum(values, 1e-9))) @ axes.T
    reach = 1.15 * float(max(np.abs(center).max() + np.linalg.norm(half, axis=1).max(), 0.06))
    out, scale = [], 150.0 / reach
    for column, (i, j) in enumerate(((0, 2), (1, 2))):
        x0, y0 = 170.0 + 340.0 * column, 170.0
        shape = half[[i, j]] @ half[[i, j]].T
        lengths, turn = np.linalg.eigh(shape)
        angle = np.degrees(np.arctan2(-turn[1, 1], turn[0, 1]))
        cx, cy = x0 + scale * center[i], y0 - scale * center[j]
        out.append(
            f'<rect x="{x0 - scale * 0.03}" y="{y0}" width="{scale * 0.06}" '
            f'height="{scale * 0.02}" fill="#999"/>'
            f'<ellipse transform="translate({cx:.1f} {cy:.1f}) rotate({angle:.1f})" '
            f'rx="{scale * np.sqrt(max(lengths[1], 0)):.1f}" ry="{scale * np.sqrt(max(lengths[0], 0)):.1f}" '
            'fill="#0072B2" fill-opacity=".25" stroke="#0072B2"/>'
        )
        for k, (dx, dy) in ((i, (1, 0)), (j, (0, 1))):
            bar = max(3.0 * scale * float(std[k]), 2.0)
            out.append(
                f'<line x1="{cx - bar * dx:.1f}" y1="{cy - bar * dy:.1f}" x2="{cx + bar * dx:.1f}" '
                f'y2="{cy + bar * dy:.1f}" stroke="#D55E00" stroke-width="2"/>'
            )
        out.append(
            f'<line x1="{x0}" y1="{y0}" x2="{x0 + 60}" y2="{y0}" stroke="#222"/>'
            f'<text x="{x0 + 64}" y="{y0 + 14}">{"xyz"[i]}</text>'
            f'<line x1="{x0}" y1="{y0}" x2="{x0}" y2="{y0 - 60}" stroke="#222"/>'
            f'<text x="{x0 - 14}" y="{y0 - 62}">{"xyz"[j]}</text>'
            f'<text x="{x0 - 150}" y="335">{60e3 / scale:.0f} mm: length of the arrows</text>'
        )
    return f'<svg viewBox="0 0 680 345" width="680" role="img" aria-label="the tool">{"".join(out)}</svg>'


def _sphere(tool: Tool, evidence: Evidence) -> str:
    poses = evidence.solution.problem.poses
    fall = poses.R_sensor_root @ tool.gravity_direction
    out = []
    for column in range(2):
        x0 = 160 + 320 * column
        out.append(f'<circle cx="{x0}" cy="150" r="140" fill="none" stroke="#888"/>')

    def put(one: Array, mark: str) -> None:
        x0 = 160 if one[2] >= 0.0 else 480
        out.append(mark.format(x=x0 + 140 * one[0], y=150 - 140 * one[1]))

    for k, one in enumerate(fall):
        put(one, '<circle cx="{x:.1f}" cy="{y:.1f}" r="4" fill="#0072B2"/>')
        if len(fall) <= 60:
            put(one, f'<text x="{{x:.1f}}" y="{{y:.1f}}" dx="5" dy="-3" font-size="10">{k + 1}</text>')
    for one in _next_best(fall):
        put(one, '<circle cx="{x:.1f}" cy="{y:.1f}" r="7" fill="none" stroke="#D55E00" stroke-width="2"/>')
    return f'<svg viewBox="0 0 640 300" width="640" role="img" aria-label="poses">{"".join(out)}</svg>'


def _next_best(fall: Array, count: int = 4) -> list[Array]:
    """Directions farthest from all that were seen, one after the other."""
    k = np.arange(400) + 0.5
    polar, turn = np.arccos(1.0 - 2.0 * k / 400), np.pi * (1.0 + 5.0**0.5) * k
    grid = np.column_stack([np.cos(turn) * np.sin(polar), np.sin(turn) * np.sin(polar), np.cos(polar)])
    seen, out = [*fall], []
    for _ in range(count):
        nearest = (grid @ np.array(seen).T).max(axis=1)
        out.append(grid[int(np.argmin(nearest))])
        seen.append(out[-1])
    return out


def _in_time(tool: Tool, evidence: Evidence) -> list[str]:
    solution = evidence.solution
    back = np.linalg.pinv(tool.gain)
    time = (solution.problem.poses.time_ns - solution.problem.poses.time_ns[0]) * 1e-9
    left, walk = solution.residual @ back.T, solution.walk @ back.T
    out = []
    for at, name, unit in ((slice(0, 3), "force", "N"), (slice(3, 6), "moment", "N m")):
        svg = _plot(time, left[:, at], walk[:, at], unit)
        out.append(
            _figure(
                svg,
                f"What is left of the {name} in the poses [{unit}] over time [s] (points), and the offset's "
                "walk that explains it (lines); x blue, y orange dashed, z green dotted.",
            )
        )
    return out


def _plot(time: Array, points: Array, lines: Array, unit: str) -> str:
    width, height, margin = 680.0, 240.0, 100.0
    span = max(float(time[-1] - time[0]), 1e-9)
    low, high = float(min(points.min(), lines.min())), float(max(points.max(), lines.max()))
    room = max(high - low, 1e-9)
    X = margin + (time - time[0]) / span * (width - margin - 20)

    def Y(values: Array) -> Array:
        return 15 + (high - values) / room * (height - 50)

    out = [
        f'<text x="2" y="20">{high:.2g} {unit}</text><text x="2" y="{height - 35}">{low:.2g} {unit}</text>'
        f'<text x="{margin}" y="{height - 8}">0 s</text>'
        f'<text x="{width - 70}" y="{height - 8}">{span:.3g} s</text>'
        f'<rect x="{margin}" y="15" width="{width - margin - 20}" height="{height - 50}" '
        'fill="none" stroke="#888"/>'
    ]
    for k, (colour, dash) in enumerate(zip(_COLOURS, _DASHES, strict=True)):
        path = " ".join(f"{x:.1f},{y:.1f}" for x, y in zip(X, Y(lines[:, k]), strict=True))
        out.append(f'<polyline points="{path}" fill="none" stroke="{colour}" stroke-dasharray="{dash}"/>')
        out += [
            f'<circle cx="{x:.1f}" cy="{y:.1f}" r="3" fill="{colour}"/>'
            for x, y in zip(X, Y(points[:, k]), strict=True)
        ]
    return f'<svg viewBox="0 0 {width} {height}" width="{width}" role="img">{"".join(out)}</svg>'


def _held(tool: Tool) -> str:
    kinds = tool.figures.get("held_out") or {}
    if not kinds:
        return "<p>Too few poses to hold some out: 8 at least.</p>"
    rows = "".join(
        f"<tr><td>{escape(kind)}</td>"
        + "".join(
            f"<td>{one[name]:.3g}</td>" for name in ("force", "recipe_force", "moment", "recipe_moment")
        )
        + "</tr>"
        for kind, one in kinds.items()
    )
    return (
        '<h2>Held-out poses</h2><div class="scroll"><table><tr><th></th><th>force [N]</th>'
        "<th>usual recipe</th><th>moment [N m]</th><th>usual recipe</th></tr>"
        f"{rows}</table></div><p>RMS of what is left in poses that the fit did not see, beside ten linear "
        "parameters with an exact gain and a fixed offset.</p>"
    )
