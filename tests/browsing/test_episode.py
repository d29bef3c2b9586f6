"""What a viewer is given: the curves, bodies, lanes and columns of every kind of episode."""

import numpy as np
import pytest

from flows.browse.making import Making
from pipeline.browsing.catalog import serving
from pipeline.errors import ConfigError
from pipeline.recording import read_episode
from pipeline.simulation.expert import Expert
from stages.browse import play_beside


def test_a_demonstration_is_shown_as_it_was_recorded(shelf, store, columns):
    episode = shelf.demonstrations[0]
    made = Making(store).episode(episode)
    with serving() as catalog:
        catalog.add("arm", [made.entry])
        found = columns(catalog, "arm", episode.id)
    _, trace = read_episode(store.blob(episode.blob))
    assert np.ravel(found["/joints/joint2/state:Scalars:scalars"]) == pytest.approx(trace.state[:, 1])
    assert np.ravel(found["/joints/joint2/command:Scalars:scalars"]) == pytest.approx(trace.joint_action[:, 1])
    hand = trace.links.index("hand")
    shown = np.array(found["/world/hand:Transform3D:translation"]).reshape(-1, 3)
    assert shown == pytest.approx(trace.link_poses[:, hand, :3], abs=1e-6)
    assert {"joints/gripper/state", "rewards/reach", "effort/joint1"} <= set(made.outlines[""].lines)


def test_the_catalog_has_a_column_for_everything_that_people_ask_by(shelf, store):
    making = Making(store)
    with serving() as catalog:
        catalog.add("arm", [making.episode(e).entry for e in (*shelf.demonstrations, *shelf.variants, shelf.failure)])
        rows = {str(row["rerun_segment_id"]): row for row in catalog.rows("arm")}
    failed, good = rows[shelf.failure.id], rows[shelf.demonstrations[0].id]
    for name, value in {"task": "pick-place", "outcome": "failure", "source": "scripted", "family": "dropped-carry",
                        "success": False, "generation": 2}.items():
        assert failed[f"property:episode:{name}"] == [value]
    assert good["property:episode:success"] == [True] and good["property:episode:family"] == [None]
    assert {row["property:episode:source"][0] for row in rows.values()} == {"scripted", "replayed", "retargeted"}
    assert set(failed["rerun_layer_names"]) == {"base", "labels", "shadow"}
    assert set(good["rerun_layer_names"]) == {"base", "labels"}


def test_a_shadow_policy_is_a_layer_with_a_curve_in_every_joints_plot(shelf, store, columns):
    made = Making(store).episode(shelf.failure)
    with serving() as catalog:
        catalog.add("arm", [made.entry])
        found = columns(catalog, "arm", shelf.failure.id)
    shadow = np.ravel(found[r"/joints/joint1/shadow\ feedfeed:Scalars:scalars"])
    command = np.ravel(found["/joints/joint1/command:Scalars:scalars"])
    assert shadow - command == pytest.approx(np.full(len(command), 0.1))
    assert [p for p in found["/states/phase:StateChange:state"] if p] == [["reach"], ["carry"]]
    assert found["/events:TextLog:text"][-1] == ["trigger: dropped"]
    assert found["/states/label:StateChange:state"][-1] == ["dropped-carry"]


def test_a_variant_moves_its_robot_though_only_its_frames_are_stored(shelf, store, columns):
    variant = shelf.variants[0]
    made = Making(store).episode(variant)
    with serving() as catalog:
        catalog.add("arm", [made.entry])
        found = columns(catalog, "arm", variant.id)
    hand = np.array(found["/world/hand:Transform3D:translation"]).reshape(-1, 3)
    assert len(hand) == variant.frames and np.ptp(hand[:, 2]) > 0.05
    thing = np.array(found["/world/object:Transform3D:translation"]).reshape(-1, 3)
    assert np.ptp(thing[:, 2]) > 0.03  # it was lifted


def test_a_demonstration_and_its_variants_share_one_time_line(shelf, store, columns):
    parent = store.episode(shelf.variants[0].parent)
    made = Making(store).beside(parent, "variants")
    with serving() as catalog:
        catalog.add("beside", [made.entry])
        found = columns(catalog, "beside", made.entry.id)
    assert list(made.outlines)[:2] == ["/demonstration", "/variant/0"]
    stored = [v for v in found["/variant/0/joints/joint1/state:Scalars:scalars"] if v]
    mine = next(v for v in shelf.variants if v.parent == parent.id)
    assert len(stored) == mine.frames
    assert found["tick"][0] == 0 and max(found["tick"]) >= parent.frames - 1


def test_beside_what_has_no_variants_says_what_to_do(shelf, store):
    with pytest.raises(ConfigError, match="mend: make some: hardcase augment"):
        Making(store).beside(shelf.failure, "variants")


def test_beside_policies_needs_a_release(shelf, store):
    with pytest.raises(ConfigError, match=r"no policy is released yet[^$]*mend: turn the loop first"):
        Making(store).beside(shelf.failure, "policies")


def test_a_policy_plays_the_scene_of_an_episode_from_the_same_start(shelf):
    episode = shelf.demonstrations[0]
    played = play_beside(episode, {"champion": Expert(), "candidate": Expert()})
    assert set(played) == {"champion", "candidate"}
    trace = played["champion"].trace
    assert trace.link_poses[0, trace.links.index("object"), :2] == pytest.approx(episode.scene.object_xy_m, abs=1e-3)
    assert played["champion"].episode.outcome.label == "success"
    assert (trace.state == played["candidate"].trace.state).all()
