"""What a log holds, seen without decoding a message: the gate that every file passes before anything trusts it."""

from pathlib import Path
from typing import Any

from pydantic import Field

from pipeline.logs.batch import Channel, Kind
from pipeline.logs.child import Children, Limits
from pipeline.logs.stream import open_log
from schemas.base import Frozen


class ChannelSeen(Frozen):
    """One channel of a log."""

    number: int
    topic: str
    encoding: str
    schema_name: str
    schema_encoding: str
    messages: int
    bytes: int = Field(description="payloads together [B]")
    first_ns: int = Field(description="earliest log time that is not 0 [ns]")
    last_ns: int = Field(description="latest log time [ns]")
    latched: int = Field(description="messages at log time 0")


class ProblemSeen(Frozen):
    """See pipeline.logs.batch.Problem."""

    what: str
    offset: int
    kind: Kind


class Inspection(Frozen):
    """A whole log, read to its end."""

    path: Path
    size: int = Field(description="of the file [B]")
    channels: tuple[ChannelSeen, ...]
    metadata: tuple[str, ...] = Field(description="names of the metadata records")
    attachments: tuple[tuple[str, int], ...] = Field(description="name and size [B]")
    problems: tuple[ProblemSeen, ...]

    @property
    def messages(self) -> int:
        """All messages."""
        return sum(channel.messages for channel in self.channels)

    @property
    def seconds(self) -> float:
        """From the first to the last message, latched ones left out [s]."""
        seen = [c for c in self.channels if c.messages > c.latched]
        return (max(c.last_ns for c in seen) - min(c.first_ns for c in seen)) / 1e9 if seen else 0.0


def inspect(path: Path, *, accept_truncated: bool = False, children: Children | None = None,
            limits: Limits | None = None) -> Inspection:
    """Read a whole log in a limited child.

    Args:
        path: the file.
        accept_truncated: see open_log.
        children: a pool to use; one child for this call without.
        limits: what reading may take; by the file's size without.

    Raises:
        RecordingError: damaged, hostile, cut off or not MCAP.
    """
    if children is None:
        with Children() as own:
            return inspect(path, accept_truncated=accept_truncated, children=own, limits=limits)
    seen = children.call(inspect_here, str(path), accept_truncated, where=path, limits=limits)
    return Inspection.model_validate(seen)


def inspect_here(path: str, accept_truncated: bool = False) -> dict[str, Any]:
    """What `inspect` does in its child, as JSON."""
    seen: dict[int, _Seen] = {}
    with open_log(Path(path), accept_truncated=accept_truncated) as log:
        for batch in log.batches():
            entry = seen.setdefault(batch.channel.number, _Seen(batch.channel))
            entry.messages += len(batch)
            entry.bytes += int(batch.sizes.sum())
            set_ns = batch.log_ns[batch.log_ns > 0]
            entry.latched += len(batch) - len(set_ns)
            if len(set_ns):
                entry.first_ns = min(entry.first_ns or int(set_ns.min()), int(set_ns.min()))
                entry.last_ns = max(entry.last_ns, int(set_ns.max()))
        channels = [seen.get(number, _Seen(channel)).told() for number, channel in sorted(log.channels.items())]
        problems = [{"what": p.what, "offset": p.offset, "kind": p.kind} for p in log.problems]
        return {"path": path, "size": log.size, "channels": channels, "problems": problems,
                "metadata": [name for name, _ in log.metadata()], "attachments": log.attached}


class _Seen:
    def __init__(self, channel: Channel) -> None:
        self.channel = channel
        self.messages = self.bytes = self.first_ns = self.last_ns = self.latched = 0

    def told(self) -> dict[str, Any]:
        c = self.channel
        return {"number": c.number, "topic": c.topic, "encoding": c.encoding, "schema_name": c.schema_name,
                "schema_encoding": c.schema_encoding, "messages": self.messages, "bytes": self.bytes,
                "first_ns": self.first_ns, "last_ns": self.last_ns, "latched": self.latched}
