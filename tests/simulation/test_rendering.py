import io
import os
import subprocess
import sys
from pathlib import Path

import mujoco
import numpy as np
import pytest
from PIL import Image

from pipeline.errors import SimulationError
from pipeline.simulation.rendering import CLOSE_UP, FilmCamera, film_strip

ROOT = Path(__file__).parents[2]
MODEL = """<mujoco>
  <worldbody>
    <light pos="0 0 2"/>
    <geom type="plane" size="2 2 .1" rgba=".8 .8 .8 1"/>
    <camera name="side" pos="0 -1.2 .3" xyaxes="1 0 0 0 0.2 1"/>
    <body name="cube" pos="0 0 .2"><freejoint/><geom type="box" size=".1 .1 .1" rgba="1 0 0 1"/></body>
  </worldbody>
</mujoco>"""
KIND = mujoco.mjtState.mjSTATE_INTEGRATION.value


@pytest.fixture(scope="module")
def model():
    return mujoco.MjModel.from_xml_string(MODEL)


def states(model, xs) -> np.ndarray:
    data, rows = mujoco.MjData(model), []
    for x in xs:
        data.qpos[0] = x
        row = np.empty(mujoco.mj_stateSize(model, KIND))
        mujoco.mj_getState(model, data, row, KIND)
        rows.append(row)
    return np.array(rows)


def red_column(frame: np.ndarray) -> float:
    red = (frame[..., 0] > 90) & (frame[..., 1] < 60)
    assert red.any()
    return float(np.nonzero(red)[1].mean())


def test_a_strip_shows_the_states_from_left_to_right(model):
    strip = film_strip(model, states(model, (-0.3, 0.0, 0.3)), camera="side", width=160, height=120)
    picture = np.array(Image.open(io.BytesIO(strip)).convert("RGB")).astype(int)
    assert picture.shape == (120, 480, 3)
    left, middle, right = (red_column(frame) for frame in np.split(picture, 3, axis=1))
    assert left < middle - 15 < middle + 15 < right


def test_pictures_are_upright_and_the_same_each_time(model):
    with FilmCamera(model, camera="side") as film:
        first, again = film.frames(states(model, (0.0,)))[0], film.frames(states(model, (0.0,)))[0]
    assert (first == again).all()
    assert first[-10:].mean() > first[:10].mean() + 20, "the bright floor lies below the dark sky"


def test_a_camera_leaves_the_model_as_it_was(model):
    model.vis.quality.shadowsize = 2048
    with FilmCamera(model, camera="side"):
        assert model.vis.quality.shadowsize == 2048


def test_a_view_needs_no_camera_in_the_model(model):
    with FilmCamera(model, camera=CLOSE_UP) as film, FilmCamera(model) as whole:
        rows = states(model, (0.2,))
        assert film.frames(rows).std() > 5 and whole.frames(rows).std() > 5, "two cameras at once both see something"


def test_rows_that_are_no_states_of_the_model_are_refused(model):
    with FilmCamera(model) as film:
        with pytest.raises(SimulationError, match=r"mend: render with the model that recorded"):
            film.frames(np.zeros((2, 3)))
        broken = states(model, (0.0, 0.1))
        broken[1, 2] = np.nan
        with pytest.raises(SimulationError, match="at:   row 1"):
            film.frames(broken)


def test_an_unknown_camera_is_refused_with_the_known_ones(model):
    with pytest.raises(SimulationError, match="mend: use one of: side"):
        FilmCamera(model, camera="back")


def elsewhere(script: str, **environment: str) -> subprocess.CompletedProcess[str]:
    """A process of its own: one process can bind OpenGL once only."""
    clean = {k: v for k, v in os.environ.items() if k not in ("MUJOCO_GL", "PYOPENGL_PLATFORM")}
    return subprocess.run([sys.executable, "-c", script], env=clean | {"PYTHONPATH": str(ROOT)} | environment,
                          capture_output=True, text=True, timeout=240, check=False)


RENDER = f"""
import mujoco, numpy as np
from pipeline.simulation.rendering import FilmCamera, backend
model = mujoco.MjModel.from_xml_string({MODEL!r})
rows = np.zeros((1, mujoco.mj_stateSize(model, {KIND})))
with FilmCamera(model, camera="side") as film:
    print(backend(), film.frames(rows).std() > 5)
"""
NO_EGL = {"__EGL_VENDOR_LIBRARY_FILENAMES": "/none"}  # libglvnd then finds no driver, as where none is installed


@pytest.mark.parametrize(("environment", "chosen"), [
    ({}, "egl"), (NO_EGL, "osmesa"), ({"MUJOCO_GL": "osmesa"}, "osmesa"), ({"MUJOCO_GL": "egl"}, "egl"),
], ids=["EGL first", "OSMesa where EGL has no driver", "OSMesa asked for", "EGL asked for"])
def test_the_backend_is_chosen_before_opengl_is_bound(environment, chosen):
    done = elsewhere(RENDER, **environment)
    assert done.stdout.split() == [chosen, "True"], done.stderr


def test_without_either_library_the_error_names_the_packages(tmp_path):
    for name in ("libOSMesa.so.8", "libOSMesa.so"):
        (tmp_path / name).write_bytes(b"")  # found first, and no library
    done = elsewhere(RENDER, LD_LIBRARY_PATH=str(tmp_path), **NO_EGL)
    assert "mend: sudo apt-get install -y libegl1 libosmesa6 libgl1" in done.stderr


def test_rendering_that_was_switched_off_says_how_to_switch_it_on():
    assert "mend: unset MUJOCO_GL" in elsewhere(RENDER, MUJOCO_GL="disable").stderr


def test_importing_the_module_binds_no_opengl():
    done = elsewhere("import sys, pipeline.simulation.rendering; print('OpenGL' in sys.modules, 'PIL' in sys.modules)")
    assert done.stdout.split()[0] == "False", done.stderr
