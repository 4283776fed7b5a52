"""The page: sections in the order in which a person asks, figures with captions, all in one file.

No script of Bokeh is part of this package: that of the installed one is written into the page. The page's
policy allows the two scripts by their hashes and nothing from outside.
"""

import base64
import hashlib
import json
import platform
import re
from collections.abc import Sequence
from functools import cache
from importlib.metadata import version
from pathlib import Path
from typing import Any

import jinja2
import numpy as np
import yaml
from bokeh.document import Document
from bokeh.resources import Resources
from markupsafe import Markup, escape

from truewrench import _core
from truewrench.estimation.evidence import Evidence
from truewrench.model.calibration import Calibration
from truewrench.model.files import atomic_output
from truewrench.report import findings, tables
from truewrench.report.contents import Figure, sections

_FOLDER = Path(__file__).parent


def page(calibration: Calibration, evidence: Evidence) -> str:
    """The whole report as HTML."""
    shown = sections(calibration, evidence)
    figures = {f.key: _embedded(f) for section in shown for f in section.figures}
    reasons = " ".join(calibration.verdict.reasons)
    told = all(direction.words in reasons for direction in calibration.verdict.undetermined)
    scripts = [*_bokeh(), _own("report.js")] if figures else []
    return _template().render(
        c=calibration,
        policy=_policy(scripts),
        style=Markup(_own("report.css")),
        scripts=[Markup(script) for script in scripts],
        figures=_json(figures),
        sections=shown,
        helps=list(findings.helps(calibration)) if not calibration.verdict.usable else [],
        undetermined=[] if told or calibration.unused else calibration.verdict.undetermined_words,
        unfit=[axis for axis, fit in calibration.axes.items() if not fit],
        notes=calibration.figures.get("notes") or [],
        stated=float(np.sqrt(np.mean(calibration.gain_std_normalised**2))),
        gain=tables.gain_table(calibration),
        offset=tables.offset_table(calibration),
        settings=yaml.safe_dump(
            calibration.rig.to_mapping(),
            sort_keys=False,
            allow_unicode=True,
            default_flow_style=None,
            width=100,
        ),
        versions={
            "TrueWrench": calibration.version,
            "core": _core.variant,
            "Python": platform.python_version(),
            **{name: version(name) for name in ("numpy", "scipy", "bokeh")},
        },
    )


def _embedded(shown: Figure) -> dict[str, Any]:
    """Bokeh's document of one figure and its place: each is drawn when it comes into sight."""
    document = Document()
    document.add_root(shown.plot)
    place = {"docid": shown.key, "roots": {shown.plot.id: shown.key}, "root_ids": [shown.plot.id]}
    return {"documents": {shown.key: document.to_json(deferred=False)}, "place": place}


@cache
def _bokeh() -> tuple[str, ...]:
    raw: Sequence[str] = Resources(mode="inline", components=["bokeh"], log_level="error").js_raw
    return ("\n".join(raw).replace("\r", ""),)


@cache
def _own(name: str) -> str:
    return (_FOLDER / name).read_text(encoding="utf-8")


def _policy(scripts: Sequence[str]) -> str:
    """Nothing from outside, no script but ours; Bokeh sets styles as it draws, and draws icons from data."""
    hashes = " ".join(
        f"'sha256-{base64.b64encode(hashlib.sha256(script.encode()).digest()).decode()}'"
        for script in scripts
    )
    allowed = hashes or "'none'"
    return (
        f"default-src 'none'; script-src {allowed}; style-src 'unsafe-inline'; img-src data:; base-uri "
        "'none'; form-action 'none'"
    )


def _json(value: Any) -> Markup:
    """JSON that no text in it can end the script element of."""
    text = json.dumps(value, allow_nan=False, separators=(",", ":"))
    return Markup(text.replace("<", "\\u003c").replace(">", "\\u003e").replace("&", "\\u0026"))


@cache
def _template() -> jinja2.Template:
    environment = jinja2.Environment(
        loader=jinja2.FileSystemLoader(_FOLDER),
        autoescape=True,
        trim_blocks=True,
        lstrip_blocks=True,
        undefined=jinja2.StrictUndefined,
    )
    environment.filters["prose"] = _prose
    return environment.get_template("report.html.j2")


def _prose(text: str) -> Markup:
    """Escaped, names between backticks as code."""
    return Markup(re.sub("`([^`]+)`", r"<code>\1</code>", str(escape(text))))


def write_report(path: str | Path, calibration: Calibration, evidence: Evidence) -> None:
    """Write the report of a calibration; the file appears whole or not at all."""
    text = page(calibration, evidence)
    with atomic_output(path) as temporary:
        temporary.write_text(text, encoding="utf-8", newline="\n")
