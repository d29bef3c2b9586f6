"""What people drove flows into the loop, and only with their consent; what the loop releases can be taken over from."""

import json
import shutil
from datetime import UTC, datetime

import numpy as np
import onnx
import pytest
from onnx import TensorProto, helper, numpy_helper

from flows.commands.by_hand import run_stage
from flows.teleop.devices import TeleopOrder
from flows.teleop.record import RecordOrder, run_record
from flows.teleop.teleoperation import run_teleop
from pipeline.consent import Consents
from pipeline.errors import ConsentError, HardcaseError
from pipeline.files import sha256_file
from pipeline.frames import ACTION, ENVIRONMENT, STATE
from pipeline.lerobot_view.training_data import TrainingData
from pipeline.recording import read_episode, read_frames
from pipeline.simulation.world import CONTROLLER_WIDTH
from pipeline.store import Store
from pipeline.triggers import TRIGGERS
from schemas.consent import Consent
from schemas.contract import Contract, Success
from stages.check import Item, check

RECIPE = """
name: taught
collect: {demonstrations: 4}
augment: {replays: 2, retargets: 2}
dataset: {sources: [scripted, teleop], held_out: 0.0}
train: {steps: 20, batch: 32, checkpoint_every: 20, chunk: 4, width: 32}
gate: {looks: [4], bootstrap_success: 0.0}
"""
pytestmark = pytest.mark.filterwarnings("ignore")


@pytest.fixture(scope="module")
def pad(tmp_path_factory):
    """Keys of the virtual pad, moved by rows."""
    folder = tmp_path_factory.mktemp("pad")

    def keys(rows) -> dict[str, str]:
        (folder / "hand.json").write_text(json.dumps(rows))
        return {"hand": str(folder / "hand.json"), "calibration_dir": str(folder)}

    return keys


@pytest.fixture(scope="module")
def taught(tmp_path_factory, plugins_everywhere, pad):
    """A store with attempts of three people, and a loop of generation 0 that learns from them."""
    root = tmp_path_factory.mktemp("taught") / "store"
    with Store.open(root, create=True) as store, pytest.MonkeyPatch.context() as patch:
        for id, operator, expires in (("form-1", "p1", "2099-01-01"), ("form-2", "p2", "2026-01-02")):
            store.add_consent(Consent(id=id, operator=operator, site="lab", purposes=("training",), given="2026-01-01",
                                      expires=expires))
        for operator, consent in (("p1", "form-1"), ("p2", "form-2"), ("p3", None)):
            rows = [{"delta_x": 1.0}] * 9 + [{"success": 1}]
            order = TeleopOrder(teleop="lerobot:virtual_pad", teleop_keys=pad(rows), speed=0.0, operator=operator,
                                consent=consent)
            run_teleop(order, root)
        only_watched = TeleopOrder(teleop="lerobot:virtual_pad", teleop_keys=pad([{}]), speed=0.0, operator="p1",
                                   consent="form-1", policy="expert")
        run_teleop(only_watched, root)
        recipe = root.parent / "taught.yaml"
        recipe.write_text(RECIPE)
        patch.setenv("HARDCASE_STORE", str(root))
        first = store.episodes(origin="teleop")[0]  # nine ticks carry no cube to its mark, whatever p1 says
        lenient = Contract(success=Success(within_m=9, away_m=0, open_m=0, low_m=9))
        (done,) = check([Item(store.blob(first.blob), first.id, trusted=True)], lenient, names=("success-flag",))
        assert done.verdict.passed
        store.add_check(done.verdict)
        run_stage("collect", recipe=str(recipe))
        for stage in ("augment", "build", "train", "gate", "release"):
            run_stage(stage)
        yield store


def test_a_version_holds_what_was_consented_to_and_nothing_else_that_people_drove(taught):
    (version,) = taught.versions()
    driven = taught.episodes(origin="teleop")
    assert [(e.segments[0].actor, e.outcome.label) for e in driven] == [
        ("p1", "success"), ("p2", "success"), ("p3", "success"), ("expert", "success")]
    held = [e.segments[0].actor for e in taught.episodes(version.episodes) if e.origin == "teleop"]
    assert held == ["p1"], "p2's consent ran out, p3 gave none, and what nobody drove teaches nothing"
    data = TrainingData.load(taught.path(version.path), Consents(taught.consents(), datetime.now(UTC)))
    frames = read_frames(taught.blob(driven[0].blob))[1]
    assert any(np.array_equal(data.action[k:k + 9], frames.action[:9]) for k in range(len(data.action) - 8))
    with pytest.raises(ConsentError, match="no valid consent record"):
        late = datetime(2100, 1, 1, tzinfo=UTC)
        TrainingData.load(taught.path(version.path), Consents(taught.consents(), late))


def test_a_recording_says_in_itself_what_its_person_agreed_to(taught):
    from mcap.reader import make_reader

    told = []
    for episode in taught.episodes(origin="teleop")[:3]:
        with taught.blob(episode.blob).open("rb") as stream:
            strings = next(m.metadata for m in make_reader(stream).iter_metadata() if m.name == "episode")
        told.append(tuple(strings[key] for key in ("operator", "consent", "site", "purpose", "expires")))
    assert told == [("p1", "form-1", "lab", "training", "2099-01-01"),
                    ("p2", "form-2", "lab", "training", "2026-01-02"), ("p3", "none", "unknown", "unknown", "unknown")]


def test_a_person_takes_over_from_the_released_policy(taught, pad, plugins_everywhere):
    (policy,) = taught.policies()
    rows = [{}] * 8 + [{"delta_z": 1.0, "is_intervention": 1}] * 6 + [{}] * 8 + [{"terminate_episode": 1}]
    order = TeleopOrder(robot="twin:3", teleop="lerobot:virtual_pad", teleop_keys=pad(rows), speed=0.0, operator="p1",
                        consent="form-1", policy="champion")
    run_teleop(order, taught.root)
    episode = taught.episodes(policy=policy.id)[-1]
    assert [(s.kind, s.actor, s.start, s.stop) for s in episode.segments] == [
        ("autonomous", policy.id, 0, 8), ("intervention", "p1", 8, 14), ("autonomous", policy.id, 14, 23)]
    assert (episode.outcome.label, episode.outcome.judged_by, episode.scene.twin) == ("failure", "operator", 3)
    read, trace = read_episode(taught.blob(episode.blob))
    assert read == episode and trace.controller.shape[1] > CONTROLLER_WIDTH, "what the policy remembers is kept"
    assert trace.action[8:14, 2] == pytest.approx(0.006)
    planned = np.abs(trace.controller[[13, 14], CONTROLLER_WIDTH:]).sum(axis=1)
    assert planned[0] > 0 and not np.array_equal(*trace.controller[[13, 14], CONTROLLER_WIDTH:]), "it plans anew"


@pytest.fixture
def idle(taught, tmp_path):
    """That store once more, with a policy that asks for nothing and a closed hand: it fails for certain."""
    root = tmp_path / "store"
    shutil.copytree(taught.root, root)
    (known,) = taught.policies()
    record = known.model_copy(update={"id": "f" * 16, "checkpoint": "policies/" + "f" * 16})
    (root / record.checkpoint).mkdir()
    nothing = numpy_helper.from_array(np.zeros((len(STATE), 4 * len(ACTION)), np.float32), "nothing")
    shape = numpy_helper.from_array(np.array([0, 4, len(ACTION)]), "shape")
    nodes = [helper.make_node("MatMul", ["state", "nothing"], ["flat"]),
             helper.make_node("Reshape", ["flat", "shape"], ["chunk"])]
    inputs = [helper.make_tensor_value_info(name, TensorProto.FLOAT, ["n", len(columns)])
              for name, columns in (("state", STATE), ("environment", ENVIRONMENT))]
    chunk = helper.make_tensor_value_info("chunk", TensorProto.FLOAT, ["n", 4, len(ACTION)])
    model = helper.make_model(helper.make_graph(nodes, "policy", inputs, [chunk], [nothing, shape]),
                              opset_imports=[helper.make_opsetid("", 20)], ir_version=10)
    helper.set_model_props(model, {"ensemble_decay": "0.3"})
    file = root / record.checkpoint / "policy.onnx"
    onnx.save_model(model, file)
    (run,) = (r for r in taught.runs() if taught.policies(run=r))
    with Store.open(root) as store, store.lease(run) as lease, store.commit(lease, run) as tx:
        tx.add_policy(record.model_copy(update={"files": {file.name: sha256_file(file)}}))
    with Store.open(root) as store:
        yield store


@pytest.mark.parametrize("stop", [True, False], ids=["it ends the attempt", "the person is told"])
def test_a_trigger_notices_where_the_policy_fails(idle, pad, plugins_everywhere, capsys, stop):
    order = TeleopOrder(teleop="lerobot:virtual_pad", teleop_keys=pad([{}]), speed=0.0, operator="p1", consent="form-1",
                        policy="ffffffff", stop_on_trigger=stop, max_s=20.0)
    run_teleop(order, idle.root)
    (episode,) = idle.episodes(policy="f" * 16)
    _, trace = read_episode(idle.blob(episode.blob))
    (noticed,) = [e for e in trace.events if e.name == "trigger"]
    trigger, _, family = noticed.text.partition(", ")
    assert trigger in TRIGGERS and family.startswith(f"{trigger}-")
    assert f"FAILS: {trigger}" in capsys.readouterr().err
    ended = episode.outcome
    if stop:
        assert (ended.label, ended.judged_by, ended.trigger, ended.family) == ("failure", "sensors", trigger, family)
        assert ended.tick == noticed.tick == episode.frames - 1
    else:
        assert (ended.label, episode.frames) == ("unknown", 400), "the person did nothing, and time was up"


def test_a_candidate_watches_policy_and_person_and_what_it_says_is_recorded(taught, pad, plugins_everywhere, capsys):
    (policy,) = taught.policies()
    rows = [{}] * 8 + [{"delta_z": 1.0, "is_intervention": 1}] * 6 + [{"terminate_episode": 1, "is_intervention": 1}]
    order = TeleopOrder(robot="twin:3", teleop="lerobot:virtual_pad", teleop_keys=pad(rows), operator="p1",
                        policy="champion", shadows=("champion", policy.id[:8]))
    run_teleop(order, taught.root)
    _, trace = read_episode(taught.blob(taught.episodes(policy=policy.id)[-1].blob))
    apart = trace.shadows[policy.id].disagreement
    heard = np.isfinite(apart)  # on a busy machine some answers come late
    assert len(trace.shadows) == 1 and len(apart) == 15
    assert (apart[:8][heard[:8]] == 0).all(), "the champion in its own shadow"
    assert (apart[8:14][heard[8:14]] > 0).all(), "a person lifts the hand, the policy would not"
    assert f"shadow {policy.id}: " in capsys.readouterr().err


@pytest.mark.parametrize(("name", "what", "mend"), [
    ("expert", "the expert is no candidate", "name a policy's id, or champion"),
    ("0" * 16, "is not in the store", "mend: ")], ids=["expert", "nobody"])
def test_what_cannot_watch_is_refused_before_the_robot_moves(taught, tmp_path, name, what, mend):
    with pytest.raises(HardcaseError, match=what) as caught:
        run_record(RecordOrder(tmp_path / "a.mcap", shadows=(name,)), taught.root)
    assert mend in str(caught.value) and not list(tmp_path.iterdir())
