"""Which parts of which frames are hidden for the faces that were found: with a margin, and over neighbouring frames."""

from collections.abc import Sequence
from itertools import pairwise

from pipeline.redaction.regions import Box
from schemas.redaction import Faces


def covered(found: Sequence[Sequence[Box]], faces: Faces) -> list[list[Box]]:
    """The boxes to hide in every frame, from the faces that were found in each.

    A face is hidden where it was found, in `carry` frames before and after, and where it was missed between two finds
    that lie at most `carry` frames apart: there the whole way from one place to the other is hidden, because nobody
    knows where on it the face was.
    """
    wide = [[_widened(box, faces.margin) for box in boxes] for boxes in found]
    hidden: list[list[Box]] = [[] for _ in wide]
    hits = [k for k, boxes in enumerate(wide) if boxes]
    for k in hits:
        for near in range(max(0, k - faces.carry), min(len(wide), k + faces.carry + 1)):
            hidden[near] += wide[k]
    for a, b in pairwise(hits):
        if 1 < b - a <= faces.carry:
            way = [_around(one, _nearest(one, wide[b])) for one in wide[a]]
            way += [_around(one, _nearest(one, wide[a])) for one in wide[b]]
            for between in range(a + 1, b):
                hidden[between] += way
    return [list(dict.fromkeys(boxes)) for boxes in hidden]


def _widened(box: Box, margin: float) -> Box:
    left, top, right, bottom = box
    x, y = (right - left) * margin + 1, (bottom - top) * margin + 1  # a pixel more for what the codec mixes
    return left - x, top - y, right + x, bottom + y


def _nearest(box: Box, others: Sequence[Box]) -> Box:
    def apart(other: Box) -> float:
        return sum((a + b - c - d) ** 2 for a, b, c, d in zip(box[:2], box[2:], other[:2], other[2:], strict=True))

    return min(others, key=apart)


def _around(one: Box, two: Box) -> Box:
    return min(one[0], two[0]), min(one[1], two[1]), max(one[2], two[2]), max(one[3], two[3])
