"""Replay: what is shown is what was rolled out, and the page holds whatever it is told."""

import io
import json
import re
import shutil
import subprocess

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from PIL import Image

import fntg_jax
from fntg_jax.commands import cli
from fntg_jax.learning.fitness import success
from fntg_jax.learning.rollout import trajectory
from fntg_jax.running import controllers, evaluation, registry, run_folder, runner
from fntg_jax.showing import replay
from tests.controllers import random_controller
from tests.small_run import small_run

WORLD = registry.get_world("kinematic")
HOSTILE = "</script><script>alert(1)</script><b title='x'>&amp;\u2028 @DATA@"
CHROMIUM = shutil.which("chromium") or shutil.which("chromium-browser")
needs_chromium = pytest.mark.skipif(CHROMIUM is None, reason="no Chromium")


@pytest.fixture(scope="module")
def panels():
    controller = random_controller(seed=3)
    return replay.record(HOSTILE, controller, WORLD, "moving-obstacles", (0, 2))


def data_of(page):
    text = re.search(r'<script type="application/json" id="data">(.*?)</script>', page, re.S)[1]
    return json.loads(text)


def test_panels_are_the_trials_that_evaluate_judges(panels):
    controller = random_controller(seed=3)
    judged = evaluation.evaluate(controller, WORLD, "moving-obstacles", 3)
    for panel, n in zip(panels, (0, 2)):
        start = np.asarray(judged.scenes.start[n])
        np.testing.assert_allclose(panel["robot"][0][:2], start[:2], atol=1e-3)
        outcome = jax.tree.map(lambda x, n=n: x[n], judged.outcome)
        assert panel["result"].startswith("success" if judged.success[n] else "no success")
        assert f"{float(outcome.distance[1]):.2f} m at step 200" in panel["result"]
        distance = np.hypot(*np.subtract(panel["robot"][200][:2], panel["ball"][-1][:2]))
        assert distance == pytest.approx(float(outcome.distance[1]), abs=2e-3)
        assert bool(success(outcome).reach) == ("ball reached" in panel["result"])


def test_lengths_and_percentages(panels):
    for panel in panels:
        assert len(panel["robot"]) == 221
        assert len(panel["ball"]) == 1  # it lies still
        assert len(panel["obstacles"]) == 221  # they walk
        for group in panel["bars"]:
            total = np.sum([row["values"] for row in group["rows"]], axis=0)
            assert np.all(np.abs(total - 100) <= len(group["rows"]))
        assert all(len(s["values"]) in (1, 220) for s in panel["signals"])


def test_page_is_self_contained_and_inert(panels):
    page = replay.page(panels, HOSTILE)
    assert data_of(page) == {"panels": panels}
    assert "alert(1)</script>" not in page
    assert page.count("<script") == 2
    assert "default-src 'none'" in page
    assert not re.search(r"(src|href)=|https?://|url\(", page)
    assert len(page.encode()) < 200_000


def test_a_page_over_the_limit_is_refused(panels):
    with pytest.raises(ValueError, match="allowed 1000000"):
        replay.page(panels * 20, "many")


def dom_of(page, tmp_path):
    """The page's DOM at 5 s, after its script has run."""
    (tmp_path / "page.html").write_text(page)
    flags = ["--headless", "--no-sandbox", "--disable-gpu", "--no-first-run"]
    flags += ["--disable-background-networking", f"--user-data-dir={tmp_path / 'profile'}"]
    url = f"{(tmp_path / 'page.html').as_uri()}#t=5"
    done = subprocess.run(
        [CHROMIUM, *flags, "--dump-dom", url], capture_output=True, text=True, timeout=120
    )
    return done.stdout


@needs_chromium
def test_page_runs_in_a_browser(panels, tmp_path):
    text = dom_of(replay.page(panels, HOSTILE), tmp_path)
    assert '<span id="time">5.0 s</span>' in text
    assert text.count("<section>") == 2
    assert "<h2>&lt;/script&gt;&lt;script&gt;alert(1)" in text
    speed = panels[0]["signals"][0]["values"]
    assert f"<dd>{speed[min(50, len(speed) - 1)]:.2f} m/s</dd>" in text


@needs_chromium
def test_keyboard(panels, tmp_path):
    press = """<script>
    const press = (key, shiftKey) => document.body.dispatchEvent(
      new KeyboardEvent("keydown", {key, shiftKey, bubbles: true, cancelable: true}));
    const seen = [];
    const keys = ["End", "ArrowRight", "Home", "ArrowRight", "ArrowRight", "shift", "ArrowLeft"];
    for (const key of keys) {
      if (key === "shift") press("ArrowRight", true); else press(key, false);
      seen.push(get("time").textContent);
    }
    press("+"); seen.push(speed.value); press("-"); press("-"); seen.push(speed.value);
    press(" "); seen.push(play.textContent); press(" "); seen.push(play.textContent);
    document.title = seen.join("|");
    </script></body>"""
    text = dom_of(replay.page(panels, "keys").replace("</body>", press), tmp_path)
    seen = re.search("<title>(.*?)</title>", text)[1]
    assert seen == "22.0 s|22.0 s|0.0 s|0.1 s|0.2 s|1.2 s|1.1 s|8|2|Pause|Play"


@needs_chromium
def test_the_page_simulates_as_python_does(tmp_path):
    """Robot, ball, obstacles and commands of 220 steps, to 1e-4, for two controllers, in float64 on
    both sides: in float32 Python itself may leave a crossing on the other side."""
    suites = ("blocked", "moving-anywhere", "traffic")
    controllers = (fntg_jax.load("bioa"), random_controller("full-63", seed=3))
    panels = [
        panel
        for controller in controllers
        for suite in suites
        for panel in replay.record("js", controller, WORLD, suite, (1, 4))
    ]
    script = """<script>
    const all = panels.map(p => {
      const f = simulate(p.play, p.field, p.play.scene);
      return [f.robot, f.ball, f.obstacles, f.v, f.omega];
    });
    element("pre", document.body, JSON.stringify(all)).id = "out";
    </script></body>"""
    text = dom_of(replay.page(panels, "js").replace("</body>", script), tmp_path)
    found = json.loads(re.search('<pre id="out">(.*?)</pre>', text)[1])
    assert len(found) == len(panels) == 12
    drawn = [evaluation.held_out_scenes(WORLD, suite, 5) for suite in suites]  # in float32
    with jax.enable_x64(True):
        double = lambda x: jnp.asarray(x, jnp.float64 if x.dtype == np.float32 else x.dtype)  # noqa: E731
        trials = []
        for controller in controllers:
            env = evaluation.environment_for(controller, WORLD)
            params = jax.tree.map(jnp.asarray, controller.params)
            run = jax.jit(lambda s, p=params, e=env, o=controller.output: trajectory(p, s, e, o))
            for scenes in drawn:
                trials += [run(jax.tree.map(lambda x, n=n: double(x[n]), scenes)) for n in (1, 4)]
    for (robot, ball, obstacles, v, omega), trial in zip(found, trials):
        shown = trial.snapshot
        turn = np.asarray(robot)[:, 2] - np.asarray(shown.robot)[:, 2]
        assert np.abs(np.exp(1j * turn) - 1).max() < 1e-4
        np.testing.assert_allclose(np.asarray(robot)[:, :2], shown.robot[:, :2], atol=1e-4)
        np.testing.assert_allclose(ball, shown.ball, atol=1e-4)
        np.testing.assert_allclose(obstacles, shown.obstacles, atol=1e-4)
        np.testing.assert_allclose(v, trial.command.v, atol=1e-4)
        np.testing.assert_allclose(omega, trial.command.omega, atol=1e-4)


@needs_chromium
def test_the_page_is_a_place_to_play(tmp_path):
    """Picking a scene, dragging ball and robot, the address, and back to what was recorded."""
    panels = [
        panel
        for seed in (3, 4)
        for panel in replay.record(f"c{seed}", random_controller(seed=seed), WORLD, "open", (0,))
    ]
    before = [p["result"] for p in panels]
    script = """<script>
    const words = () => views.map(v => v.words.textContent), seen = {first: words()};
    const at0 = panels[0].play.scene.ball.slice(0, 2);
    const send = (type, x, y) => {
      const canvas = views[0].field, box = canvas.getBoundingClientRect();
      const scale = scaleOf(canvas, panels[0].field);
      canvas.dispatchEvent(new PointerEvent(type, {
        bubbles: true, pointerId: 1,
        clientX: box.left + box.width / 2 + x * scale,
        clientY: box.top + box.height / 2 - y * scale,
      }));
    };
    send("pointerdown", ...at0);
    send("pointermove", 0.5, -0.25);
    send("pointerup", 0.5, -0.25);
    seen.balls = panels.map(p => p.play.scene.ball.slice(0, 2));
    seen.dragged = words(); seen.hash = location.hash;
    get("scene").value = "3";
    get("scene").dispatchEvent(new Event("change"));
    seen.picked = words();
    location.hash = "#t=7&s=-1,0,0;0.5,0.25,0,0;0,0.5,0.1,0,0"; readAddress();
    seen.starts = panels.map(p => p.robot[0]); seen.time = get("time").textContent;
    location.hash = "#t=7"; readAddress();
    seen.unnamed = words();
    location.hash = "#t=7&s=-1,0,0;0.5,0.25,0,0;0,0.5,0.1,0,0"; readAddress();
    get("back").click(); seen.back = words();
    // A finger need not hit the knob; a mouse has to.
    const {start} = panels[0].play.scene, x = start[0] + KNOB * Math.cos(start[2]) + 0.12;
    const y = start[1] + KNOB * Math.sin(start[2]) + 0.12;
    seen.hit = [0, 0.3].map(least => grip(panels[0], x, y, least) !== null);
    element("pre", document.body, JSON.stringify(seen)).id = "out";
    </script></body>"""
    page = replay.page(panels, "play", replay.choice(WORLD, "open", num=5))
    text = dom_of(page.replace("</body>", script), tmp_path)
    seen = json.loads(re.search('<pre id="out">(.*?)</pre>', text)[1])
    assert [w.partition(". ")[2] for w in seen["first"]] == before
    np.testing.assert_allclose(seen["balls"], [[0.5, -0.25]] * 2, atol=0.02)
    assert all(w.startswith("your scene. ") for w in seen["dragged"])
    assert "&amp;s=" in seen["hash"] or "&s=" in seen["hash"]
    assert all(w.startswith("open scene 3. ") for w in seen["picked"])
    np.testing.assert_allclose(seen["starts"], [[-1, 0, 0]] * 2)
    assert seen["time"] == "7.0 s"
    assert seen["unnamed"] == seen["back"] == seen["first"]
    assert seen["hit"] == [False, True]


@pytest.mark.parametrize("image_format", ["GIF", "WEBP"])
def test_animation(panels, image_format):
    short = [{**p, "robot": p["robot"][:9], "obstacles": p["obstacles"][:9]} for p in panels]
    image = Image.open(io.BytesIO(replay.animation(short, image_format, width=500)))
    assert (image.format, image.n_frames) == (image_format, 6)
    assert abs(image.size[0] - 500) <= 1
    first = np.asarray(image.convert("RGB"), int)
    image.seek(4)
    moved = np.asarray(image.convert("RGB"), int)
    assert np.abs(moved - first).max() > 50
    image.seek(5)  # the same place, with the result in words
    differs = np.abs(np.asarray(image.convert("RGB"), int) - moved).max(axis=(1, 2)) > 50
    low = int(0.8 * image.size[1])
    assert differs[low:].mean() > 0.3 > 0.1 > differs[:low].mean()


@pytest.mark.slow
def test_no_film_is_over_3_mb():
    noise = np.random.default_rng(0).integers(0, 255, (60, 300, 400, 3), np.uint8)
    data = replay.encode([Image.fromarray(x) for x in noise], 0.1, "GIF")
    assert len(data) <= replay.MOST_FILM_BYTES
    image = Image.open(io.BytesIO(data))
    image.seek(image.n_frames - 1)
    assert image.info["duration"] == 2000


@pytest.fixture
def folder_and_run():
    folder = small_run()
    return folder, run_folder.restore(folder)


def test_controllers_of_generations(folder_and_run):
    folder, run = folder_and_run
    best = controllers.of_run(run)
    index = best.provenance["seed"] - 5
    theta = runner.decode_history(run.history(), run.config)
    for generation in (1, 2):
        found = controllers.of_generation(folder, generation)
        np.testing.assert_array_equal(found.theta, theta[index, generation - 1].astype(float))
    with pytest.raises(ValueError, match="generation = 3: the run has 1 to 2"):
        controllers.of_generation(folder, 3)


def test_replay_command(folder_and_run, tmp_path, capsys):
    folder, _ = folder_and_run
    out = tmp_path / "replay.html"
    cli.main(["replay", str(folder), "--generations", "1", "2", "--scene", "1", "--out", str(out)])
    assert capsys.readouterr().out == f"{out}\n"
    titles = [p["title"] for p in data_of(out.read_text())["panels"]]
    assert titles == ["<b>run & @BODY@, generation 1", "<b>run & @BODY@, generation 2"]


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["--out", "x.mp4"], "out = x.mp4: allowed are"),
        (["--scene", "-1"], "scene = [-1]: allowed are"),
        (["--scene", *"0123456789" * 3], "30 trials: allowed are up to 24"),
        (["--generations", "7"], "generation = 7: the run has 1 to 2"),
        (["--suite", "no"], "suite = 'no': known are"),
    ],
)
def test_bad_input_is_one_line(folder_and_run, capsys, arguments, message, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    with pytest.raises(SystemExit) as stop:
        cli.main(["replay", str(folder_and_run[0]), *arguments])
    assert stop.value.code == 2
    said = capsys.readouterr().err
    assert said.startswith(f"fntg: error: {message}")
    assert said.count("\n") == 1
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("damage", [b"", b"PK\x03\x04 not a zip", None])
def test_damaged_history_is_one_line(folder_and_run, tmp_path, damage):
    folder = tmp_path / "copy"
    shutil.copytree(folder_and_run[0], folder)
    path = folder / "history.npz"
    path.write_bytes(path.read_bytes()[:-40] if damage is None else damage)
    with pytest.raises(ValueError, match=r"history\.npz: not the history of this run"):
        controllers.of_generation(folder, 1)
