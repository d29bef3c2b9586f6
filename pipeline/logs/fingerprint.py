"""What a log carries as hashes, whatever its chunks and compression: tells whether two files hold the same."""

import hashlib
import struct
from pathlib import Path
from typing import Any

from pipeline.logs.batch import Batch
from pipeline.logs.stream import open_log

_FIELDS = struct.Struct("<QQIQ")


def fingerprint_here(path: str, accept_truncated: bool = False) -> dict[str, Any]:
    """Hashes of everything that a log gives, as JSON for child.py.

    Returns:
        channels: number -> {declared, messages, sha256}, the last over times, sequence and payload of every
        message in file order; metadata and attachments: one hash each; problems: what and kind.

    Raises:
        RecordingError: see pipeline.logs.stream.
    """
    found: dict[int, Any] = {}
    counts: dict[int, int] = {}
    with open_log(Path(path), accept_truncated=accept_truncated) as log:
        for batch in log.batches():
            number = batch.channel.number
            digest = found.setdefault(number, hashlib.sha256())
            counts[number] = counts.get(number, 0) + len(batch)
            _add(digest, batch)
        channels = {
            str(number): {
                "declared": _text_hash(c.topic, c.encoding, c.schema_name, c.schema_encoding, c.schema.hex(),
                                       *(f"{key}={value}" for key, value in sorted(c.metadata.items()))),
                "messages": counts.get(number, 0),
                "sha256": found.get(number, hashlib.sha256()).hexdigest(),
            }
            for number, c in sorted(log.channels.items())
        }
        metadata = [part for name, values in log.metadata() for part in (name, repr(sorted(values.items())))]
        attached = [f"{name} {media} {hashlib.sha256(data).hexdigest()}" for name, media, data in log.attachments()]
        return {"channels": channels, "metadata": _text_hash(*metadata), "attachments": _text_hash(*attached),
                "problems": [[p.what, p.kind] for p in log.problems]}


def _add(digest: Any, batch: Batch) -> None:
    view, pack = memoryview(batch.data), _FIELDS.pack
    rows = zip(batch.starts.tolist(), batch.sizes.tolist(), batch.log_ns.tolist(), batch.publish_ns.tolist(),
               batch.sequence.tolist(), strict=True)
    for start, size, log_ns, publish_ns, sequence in rows:
        digest.update(pack(log_ns, publish_ns, sequence, size))
        digest.update(view[start : start + size])


def _text_hash(*parts: str) -> str:
    return hashlib.sha256(b"".join(part.encode() + b"\0" for part in parts)).hexdigest()
