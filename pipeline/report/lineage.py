"""The picture of a lineage: one SVG file that any browser shows, light or dark, without a network."""

from types import MappingProxyType

from markupsafe import escape

from pipeline.report.layers import lay_out
from pipeline.store.graph import Graph, Node, in_order

WIDTH, PAD, GAP_Y, TOP = 256.0, 24.0, 44.0, 58.0
"""Width of a box, margin, space between layers, and room for the heading."""
HEAD, LINE, FOOT = 23.0, 15.5, 8.0
"""Height of a title, of a line, and of the space below."""
LETTERS, LETTERS_OF_TITLE = 34, 29
"""As many letters of a line fit into a box in a wide type; what is cut off shows under the pointer."""
LETTER_OF_HEADING = 10.0
"""Width of a letter of the heading, in a wide type."""

COLOURS: MappingProxyType[str, int] = MappingProxyType({
    "consent": 0, "raw_log": 1, "conversion": 1, "episode": 2, "hard_case": 3, "version": 4, "policy": 5, "verdict": 6,
    "release": 6, "checked": 7, "run": 7, "erased": 3,
})
"""Kind -> its colour in the style sheet."""

_LIGHT = ("#7a5cc4", "#64748b", "#2f7fc1", "#c2571a", "#0f8a75", "#b0288a", "#6b7f0a", "#8a6d3b")
_DARK = ("#b49cf2", "#9aa8bb", "#6db3ee", "#f08f4f", "#3cc8ae", "#ee7fcb", "#b9cf4a", "#d0b07c")


def picture(graph: Graph) -> str:
    """Draw a graph: causes above effects, the thing that was asked about with a thick border."""
    nodes = in_order(graph)
    plan = lay_out([n.key for n in nodes], graph.edges, WIDTH)
    by_key = {n.key: n for n in nodes}
    heights = [max((_height(by_key[k]) for k in row), default=0.0) for row in plan.layers]
    tops = [TOP + sum(heights[:k]) + k * GAP_Y for k in range(len(heights))]
    width, height = plan.width + 2 * PAD, TOP + sum(heights) + GAP_Y * (len(heights) - 1) + PAD + 18 * graph.cut
    focus = next(n for n in nodes if n.focus)
    parts = [_arrow(plan.ways[edge], plan.first[edge[0]], plan.first[edge[1]], tops, heights,
                    _height(by_key[edge[0]]), _touches(edge, focus)) for edge in graph.edges]
    for row, top in zip(plan.layers, tops, strict=True):
        parts += [_box(by_key[k], PAD + plan.x[k] - WIDTH / 2, top) for k in row]
    if graph.cut:
        parts.append(f'<text class="soft" x="{PAD}" y="{height - 12:g}">there is more than is shown here</text>')
    heading = f"{focus.title}: what it came from, and what came of it"
    return _page(heading, "\n".join(parts), max(width, 2 * PAD + LETTER_OF_HEADING * len(heading)), height)


def _touches(edge: tuple[str, str], focus: Node) -> bool:
    return focus.key in edge


def _height(node: Node) -> float:
    return HEAD + LINE * len(node.lines) + FOOT


def _box(node: Node, left: float, top: float) -> str:
    height = _height(node)
    shown = " ".join(["box", *(["focus"] if node.focus else []), *(["bad"] if node.bad else [])])
    lines = "".join(f'<text x="{left + 14:g}" y="{top + HEAD + LINE * k + 11:g}" class="{_tone(line)}">'
                    f"{escape(_short(line))}</text>" for k, line in enumerate(node.lines))
    about = "\n".join([node.title, *node.lines, *node.ids[:20], *(["..."] if len(node.ids) > 20 else [])])
    stack = "" if len(node.ids) == 1 else (
        f'<rect class="behind" x="{left + 5:g}" y="{top + 5:g}" width="{WIDTH:g}" height="{height:g}" rx="7"/>')
    return (f'<g><title>{escape(about)}</title>{stack}<rect class="{shown}" x="{left:g}" y="{top:g}" '
            f'width="{WIDTH:g}" height="{height:g}" rx="7"/><rect class="c{COLOURS.get(node.kind, 7)}" '
            f'x="{left + 1:g}" y="{top + 7:g}" width="4" height="{height - 14:g}" rx="2"/>'
            f'<text class="title" x="{left + 14:g}" y="{top + 17:g}">'
            f"{escape(_short(node.title, LETTERS_OF_TITLE))}</text>{lines}</g>")


def _tone(line: str) -> str:
    if line.startswith(("incomplete", "saw what", "forgotten", "FAIL", "revoked")):
        return "bad"
    return "good" if line.startswith(("PASS", "the champion", "passed")) else "soft"


def _short(text: str, most: int = LETTERS) -> str:
    return text if len(text) <= most else text[:most - 1] + "…"


def _arrow(way: tuple[float, ...], first: int, last: int, tops: list[float], heights: list[float], height: float,
           strong: bool) -> str:
    """A curve from the lower edge of a cause to the upper edge of its effect, upright where it passes a layer."""
    if last < first:  # it was turned round, for it closes a circle
        way, first, last = way[::-1], last, first
        height = heights[first]
    x, y = PAD + way[0], tops[first] + height
    path = [f"M{x:.1f} {y:.1f}"]
    for k, here in enumerate(way[1:], first + 1):
        below, end = PAD + here, tops[k] - (7 if k == last else 0)
        bend = max((end - y) * 0.5, 12.0)
        path.append(f"C{x:.1f} {y + bend:.1f} {below:.1f} {end - bend:.1f} {below:.1f} {end:.1f}")
        x, y = below, end
        if k != last:
            y = tops[k] + heights[k]
            path.append(f"V{y:.1f}")
    return f'<path class="edge{" near" if strong else ""}" d="{"".join(path)}" marker-end="url(#tip)"/>'


def _page(heading: str, body: str, width: float, height: float) -> str:
    light = "".join(f".c{k}{{fill:{c}}}" for k, c in enumerate(_LIGHT))
    dark = "".join(f".c{k}{{fill:{c}}}" for k, c in enumerate(_DARK))
    style = (
        "svg{--page:#ffffff;--card:#f7f8fa;--ink:#1b2330;--soft:#566072;--line:#c5ccd6;--edge:#8b96a6;--bad:#b3261e;"
        "--good:#17702f;--focus:#1f5fbf;color-scheme:light dark;background:var(--page)}"
        "@media(prefers-color-scheme:dark){svg{--page:#14181f;--card:#1f2630;--ink:#e8edf4;--soft:#a9b4c3;"
        f"--line:#3d4858;--edge:#74808f;--bad:#ff8f85;--good:#78d68f;--focus:#74aaff}}{dark}}}"
        "text{font:12px system-ui,-apple-system,'Segoe UI','Liberation Sans',sans-serif;fill:var(--soft)}"
        ".title{font-size:12.5px;font-weight:600;fill:var(--ink)}.heading{font-size:16px;font-weight:600;"
        "fill:var(--ink)}.soft{fill:var(--soft)}.bad{fill:var(--bad)}.good{fill:var(--good)}"
        ".box{fill:var(--card);stroke:var(--line)}.box.bad{fill:var(--card);stroke:var(--bad)}"
        ".box.focus{stroke:var(--focus);stroke-width:2.5}.behind{fill:var(--card);stroke:var(--line)}"
        ".edge{fill:none;stroke:var(--edge);stroke-width:1.2}.near{stroke:var(--focus);stroke-width:1.8}"
        ".tip{fill:var(--edge)}")
    return (f'<svg xmlns="http://www.w3.org/2000/svg" width="{width:.0f}" height="{height:.0f}" '
            f'viewBox="0 0 {width:.0f} {height:.0f}" role="img" aria-label="{escape(heading)}">'
            f"<title>{escape(heading)}</title><style>{light}{style}</style>"
            '<defs><marker id="tip" viewBox="0 0 8 8" refX="1" refY="4" markerWidth="7" markerHeight="7" '
            'markerUnits="userSpaceOnUse" orient="auto"><path class="tip" d="M0 0 8 4 0 8z"/></marker></defs>'
            f'<rect width="100%" height="100%" fill="var(--page)"/>'
            f'<text class="heading" x="{PAD:g}" y="32">{escape(heading)}</text>\n{body}\n</svg>\n')
