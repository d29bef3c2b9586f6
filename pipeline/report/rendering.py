"""Rendering: a template of ours as one HTML page that needs nothing but itself."""

import base64
import hashlib
from collections.abc import Callable, Mapping
from pathlib import Path
from types import MappingProxyType

from jinja2 import Environment, FileSystemLoader, StrictUndefined
from markupsafe import Markup

from pipeline.report import text

HERE = Path(__file__).parent

type Filters = Mapping[str, Callable[..., object]]

FILTERS: Filters = MappingProxyType({
    "percent": text.percent, "interval": text.interval, "points": text.points, "p": text.p_value,
    "p_equals": text.p_equals, "number": text.number, "duration": text.duration, "words": text.words})
"""Filters that every template has."""


def render(template: str, *, interactive: bool, filters: Filters = FILTERS, **values: object) -> str:
    """HTML with its style, script and charts inside; every text in it is escaped.

    The content security policy admits our one style and our one script by their hashes and nothing
    from anywhere else: not even a hostile name that escaped the escaping could load or run something.

    Args:
        template: file beside this one.
        interactive: whether the page has our script, and pictures.
        filters: further filters of this template.
        values: what the template shows.
    """
    environment = Environment(loader=FileSystemLoader(HERE), autoescape=True, undefined=StrictUndefined,
                              trim_blocks=True, lstrip_blocks=True)
    environment.filters |= {**FILTERS, **filters}  # pyright: ignore[reportUnknownMemberType]
    style, script = (HERE / "style.css").read_text("utf-8"), (HERE / "script.js").read_text("utf-8")
    more = f"img-src data:; script-src '{_digest(script)}'; " if interactive else ""
    policy = f"default-src 'none'; style-src '{_digest(style)}'; {more}base-uri 'none'; form-action 'none'"
    return environment.get_template(template).render(
        **values, policy=policy, style=Markup(style), script=Markup(script))


def _digest(inline: str) -> str:
    return "sha256-" + base64.b64encode(hashlib.sha256(inline.encode()).digest()).decode()
