"""What every test shares."""

import io
import sys
from collections.abc import Callable, Iterable, Iterator

import pytest
from mcap.records import Attachment, Channel, DataEnd, Header, Message, Metadata, Schema
from mcap.stream_reader import StreamReader
from mcap.writer import Writer

from flows import cli
from pipeline.lerobot_view.scheduling import fair


@pytest.fixture(autouse=True)
def _no_test_takes_the_machine() -> Iterator[None]:
    """lerobot's own encoder, run by root, leaves the process real-time, and its children starve all others."""
    with fair():
        yield


@pytest.fixture(scope="session")
def strider_urdf() -> str:
    """A robot of one hinge that stands on its leg, as people hand it in."""
    return """
<robot name="strider">
  <link name="trunk"><inertial><mass value="4"/><inertia ixx=".04" iyy=".04" izz=".04" ixy="0" ixz="0" iyz="0"/>
    </inertial><collision><geometry><box size=".2 .2 .2"/></geometry></collision></link>
  <link name="leg"><inertial><origin xyz="0 0 -.2"/><mass value="1"/>
    <inertia ixx=".01" iyy=".01" izz=".001" ixy="0" ixz="0" iyz="0"/></inertial>
    <collision><origin xyz="0 0 -.2"/><geometry><box size=".16 .1 .4"/></geometry></collision></link>
  <joint name="hip" type="revolute"><parent link="trunk"/><child link="leg"/><axis xyz="0 1 0"/>
    <limit lower="-1" upper="1" effort="30" velocity="10"/><dynamics damping=".5"/></joint>
</robot>
"""


@pytest.fixture(scope="session")
def interrupted() -> Callable[[type], type]:
    """Makes a kind of policy one during whose tick `at` something `happens` to somebody else."""
    def kind(policy: type) -> type:
        class Interrupted(policy):
            at, happens, tick = -1, staticmethod(lambda: None), 0

            def act(self, observation, ids):
                if self.tick == self.at:
                    self.happens()
                self.tick += 1
                return super().act(observation, ids)

        return Interrupted

    return kind


@pytest.fixture
def hardcase(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> Callable[..., tuple]:
    """Types a command line in this process; returns exit code, stdout and stderr."""

    def typed(*words: object) -> tuple[int, str, str]:
        monkeypatch.setattr(sys, "argv", ["hardcase", *map(str, words)])
        with pytest.raises(SystemExit) as left:
            cli.main()
        said = capsys.readouterr()
        return left.value.code or 0, said.out, said.err

    return typed


@pytest.fixture(scope="session")
def rewritten() -> Callable[..., bytes]:
    """Writes a log again with the mcap library, every message passed through `change`, which gives those to write."""

    def again(data: bytes, change: Callable[[str, Message], Iterable[Message]], chunk_size: int = 1 << 20) -> bytes:
        out = io.BytesIO()
        writer = Writer(out, enable_data_crcs=True, chunk_size=chunk_size)
        schemas: dict[int, int] = {}
        channels: dict[int, tuple[int, str]] = {}
        for record in StreamReader(io.BytesIO(data)).records:
            match record:
                case Header():
                    writer.start(record.profile, "somebody else")
                case Metadata():
                    writer.add_metadata(record.name, record.metadata)
                case Attachment():
                    writer.add_attachment(record.create_time, record.log_time, record.name, record.media_type,
                                          record.data)
                case Schema():
                    schemas[record.id] = writer.register_schema(record.name, record.encoding, record.data)
                case Channel():
                    number = writer.register_channel(record.topic, record.message_encoding, schemas[record.schema_id])
                    channels[record.id] = (number, record.topic)
                case Message():
                    number, topic = channels[record.channel_id]
                    for new in change(topic, record):
                        writer.add_message(number, new.log_time, new.data, new.publish_time, new.sequence)
                case DataEnd():
                    break
                case _:
                    pass
        writer.finish()
        return out.getvalue()

    return again
