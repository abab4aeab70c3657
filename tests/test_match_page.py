"""The match's page in a browser at desktop and phone size, and the film."""

import io
import re
import shutil
import subprocess
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from envs.field import FIELD
from fntg_jax.showing import film, match_film, match_page

CHROMIUM = shutil.which("chromium") or shutil.which("chromium-browser")
needs_chromium = pytest.mark.skipif(CHROMIUM is None, reason="no Chromium")
STEPS, ROBOTS = 6000, 6


@pytest.fixture(scope="module")
def shown():
    """A half of 10 minutes: robots that go about at random, with beliefs and labels; two goals."""
    rng = np.random.default_rng(0)
    walk = np.cumsum(rng.normal(0, 0.02, (STEPS, ROBOTS, 2)), 0)
    place = np.sin(walk) * (1.3, 0.8)
    heading = np.sin(np.cumsum(rng.normal(0, 0.1, (STEPS, ROBOTS, 2)), 0))
    ball = np.sin(np.cumsum(rng.normal(0, 0.02, (STEPS, 2)), 0)) * (1.3, 0.8)
    score = np.zeros((STEPS, 2), int)
    score[300:, 0] += 1
    score[900:, 1] += 1
    return match_page.Recording(
        dt=0.1,
        teams=("<b>reds</b>", "blues"),
        robots=np.concatenate([place, heading], -1),
        on=rng.random((STEPS, ROBOTS)) > 0.01,
        ball=ball,
        score=score,
        calls=(
            match_page.Call(30.0, "goal for reds", "goal0"),
            match_page.Call(90.0, "goal for blues", "goal1"),
            match_page.Call(200.0, "ball holding: reds 2", "call"),
        ),
        field=FIELD,
        beliefs=np.concatenate([place, heading[..., :1], place], -1) + rng.normal(0, 0.05, 5),
        labels=np.zeros((STEPS, ROBOTS, 3), int),
        says=rng.random((STEPS, ROBOTS)) < 0.1,
        roles=(("attacker",), ("attacker",)),
        behaviors=(("kick",), ("BIOA",)),
        rules=(("the ball is near",), ("far",)),
    )


def test_a_half_is_below_2_mb(shown):
    page = match_page.page(shown)
    assert len(page.encode()) < 2e6
    assert not re.search(r"(src|href)=|https?://", page)
    assert "<b>reds" not in page


def browser(page, tmp_path, *flags, fragment="t=31"):
    path = tmp_path / "match.html"
    path.write_text(page)
    always = ["--headless", "--no-sandbox", "--disable-gpu", "--no-first-run", "--disable-quic"]
    always += ["--disable-background-networking", "--virtual-time-budget=3000"]
    always += [f"--user-data-dir={tmp_path / 'profile'}"]
    command = [CHROMIUM, *always, *flags, f"{path.as_uri()}#{fragment}"]
    done = subprocess.run(command, capture_output=True, text=True, timeout=120, check=False)
    return done.stdout


@needs_chromium
def test_keys_buttons_and_touch(shown, tmp_path):
    press = """<script>
    const press = (key, shiftKey) => document.body.dispatchEvent(
      new KeyboardEvent("keydown", {key, shiftKey, bubbles: true, cancelable: true}));
    const seen = [], now = () => seen.push(time.toFixed(1) + " " + $("score").textContent);
    seek(0); now(); press("ArrowRight"); now(); press("ArrowRight", true); now();
    press("ArrowLeft"); now(); press("n"); now(); press("n"); now(); press("p"); now();
    $("next").click(); now(); press("2"); seen.push(only, $("beliefs").checked);
    press(" "); seen.push($("play").textContent); press(" "); seen.push($("play").textContent);
    const box = $("bar").getBoundingClientRect();
    $("bar").setPointerCapture = () => 0;
    $("bar").dispatchEvent(new PointerEvent("pointerdown",
      {pointerType: "touch", clientX: box.left + box.width / 2, buttons: 1}));
    seen.push(time.toFixed(0));
    seek(31); seen.push($("call").textContent, $("robots").tBodies[0].rows[0].innerText);
    document.title = seen.join("|");
    </script></body>"""
    text = browser(match_page.page(shown).replace("</body>", press), tmp_path, "--dump-dom")
    seen = re.search("<title>(.*?)</title>", text)[1].split("|")
    assert seen[:4] == ["0.0 0 : 0", "1.0 0 : 0", "11.0 0 : 0", "10.0 0 : 0"]
    assert seen[4:8] == ["26.0 0 : 0", "86.0 1 : 0", "26.0 0 : 0", "86.0 1 : 0"]
    assert seen[8:12] == ["2", "true", "Pause", "Play"]
    assert abs(float(seen[12]) - 300) < 2
    assert seen[13] == "goal for reds"
    assert all(word in seen[14] for word in ("attacker", "kick", "the ball is near", "cm"))
    assert "&lt;b&gt;reds" in text


@needs_chromium
@pytest.mark.parametrize("size", [(1280, 800), (390, 844)])
@pytest.mark.parametrize("dark", [False, True])
def test_it_fills_desktop_and_phone(shown, size, dark, tmp_path):
    # Wider than the window, or the buttons below its end: the test then misses the field.
    fits = """<script>
    if (document.documentElement.scrollWidth > innerWidth ||
        $("controls").getBoundingClientRect().bottom > innerHeight) $("field").remove();
    </script></body>"""
    page = match_page.page(shown).replace("</body>", fits)
    if dark:
        page = page.replace("prefers-color-scheme: dark", "min-width: 1px")
    shot = tmp_path / "shot.png"
    flags = [f"--window-size={size[0]},{size[1]}", f"--screenshot={shot}"]
    browser(page, tmp_path, *flags)
    picture = np.asarray(Image.open(shot).convert("RGB")).astype(int)
    red, green, blue = picture[..., 0], picture[..., 1], picture[..., 2]
    grass = (green > red + 30) & (green > blue + 20)
    assert grass.mean() > 0.15  # the field is there, and all fits the window
    assert ((red > 180) & (blue < 80)).sum() > 50  # ball and own team
    corner = picture[2, 2].mean()
    assert corner < 60 if dark else corner > 200


@pytest.mark.parametrize("image_format", ["GIF", "WEBP"])
def test_film(shown, image_format):
    path = Path(f"x.{image_format.lower()}")
    data = film.encoded(match_film.pictures(shown, 25.0, 8.0), 0.2, path)
    assert len(data) < 3e6
    with Image.open(io.BytesIO(data)) as moving:
        assert moving.format == image_format and moving.n_frames >= 41
        frames = []
        for n in (0, moving.n_frames - 1):
            moving.seek(n)
            frames.append(np.asarray(moving.convert("RGB")).astype(int))
    height, width = frames[0].shape[:2]
    middle = np.s_[height // 2 : height // 2 + 20, width // 2 - 60 : width // 2 + 60]
    # At the end the score stands in the middle: white on dark.
    assert frames[1][middle].min() < 80 < 200 < frames[1][middle].max()
    assert np.abs(frames[1][middle] - frames[0][middle]).mean() > 30


def test_a_film_begins_within_the_match(shown):
    with pytest.raises(ValueError, match="film_from = 700"):
        match_film.pictures(shown, 700.0, 8.0)
