"""The page that plays a run: what it holds, what its JavaScript draws (in V8, without a browser), and in Chromium.

V8 is that of the package mini-racer. Chromium is used where the machine has it.
"""

import base64
import json
import re
import shutil
import subprocess
import threading
import zlib

import numpy as np
import pytest
from conftest import ROOT, circles_at
from matplotlib import colormaps

import deep_contact as dc
from deep_contact.plot import player

WIDE, HIGH = 300, 200
LOOK = {"colour": "speed", "forces": False, "picked": -1, "back": "#ffffff", "edge": "#333333", "force": "#d55e00"}
LOOK |= {"halo": "#ffffff", "text": "#1a1a1a", "mark": "#cc0077"}


@pytest.fixture(scope="module")
def pile():
    """The states of a pile that falls on a belt beside a slope."""
    world = dc.World(box=(-3.0, 1.0, 12.0, 11.0), segments=[((0, 3), (4, 2)), ((6, 2), (11, 2))], surface_speeds=[0, 1])
    grid = np.stack(np.meshgrid(np.arange(-2.0, 11.0, 1.3), np.arange(4.0, 9.0, 1.3)), -1).reshape(-1, 2)
    bodies = dc.make_bodies(grid, radius=np.linspace(0.6, 0.3, len(grid)), spin=3.0)
    scene = dc.State(name="pile", world=world, bodies=bodies)
    return dc.simulate(scene, steps=120, record=10, solver=dc.PGS()).trajectory


@pytest.fixture(scope="module")
def poured():
    """States of other numbers of circles, and a segment that comes and goes."""
    one = dc.find_contacts(circles_at([[2.0, 1.0]], box=(0, 0, 10, 10)))
    three = dc.find_contacts(
        circles_at([[2.0, 1.0], [3.9, 1.0], [7, 7]], box=(0, 0, 10, 10), segments=[((1, 5), (9, 5))])
    )
    return [one, three.replace(time=0.5), one.replace(time=2.0)]


class Page:
    """`player.js` in V8, with the data of a page."""

    def __init__(self, states, **options):
        racer = pytest.importorskip("py_mini_racer").MiniRacer()
        data = player.page_data(list(states), **options)
        data = json.loads(json.dumps(data))
        columns = {name: [*zlib.decompress(base64.b64decode(text))] for name, text in data.pop("columns").items()}
        racer.eval((ROOT / "deep_contact/plot/player.js").read_text(encoding="utf-8"))
        racer.eval(f"const bytes = {json.dumps(columns)}, columns = {{}}")
        racer.eval("for (const name in bytes) columns[name] = Uint8Array.from(bytes[name])")
        racer.eval(f"const run = player.runOf({json.dumps(data)}, columns)")
        self._racer = racer

    def __call__(self, expression):
        return json.loads(self._racer.eval(f"JSON.stringify({expression})"))

    def array(self, expression):
        """Of a typed array."""
        return np.array(self(f"Array.from({expression})"))

    def picture(self, k, view, **look):
        """State k in a view, (HIGH, WIDE, 3)."""
        self._racer.eval(f"var picture = {{pixels: new Uint32Array({WIDE * HIGH}), width: {WIDE}, height: {HIGH}}}")
        self._racer.eval(f"player.paint(picture, run, {k}, {json.dumps(view)}, {json.dumps(LOOK | look)})")
        words = self.array("picture.pixels").astype(np.uint32)
        return words.view(np.uint8).reshape(HIGH, WIDE, 4)[:, :, :3].astype(float)

    def views(self, x, y):
        """The whole box, and twice closer around a place."""
        whole = self(f"player.wholeView(run.box, {WIDE}, {HIGH}, 1)")
        near = [
            self(f"player.zoomed({json.dumps(whole)}, {factor}, ...player.toPixels({json.dumps(whole)}, {x}, {y}))")
            for factor in (3, 12)
        ]
        return whole, *near


def pixel(view, x, y):
    """Row and column of a place, m."""
    u, v = WIDE / 2 + (x - view["x"]) * view["scale"], HIGH / 2 - (y - view["y"]) * view["scale"]
    return int(np.floor(v)), int(np.floor(u))


# ---- what the page holds ----


def test_numbers_come_back_as_exact_as_they_are_meant(pile):
    """Places to 1/2000 of the smallest radius, angles to 2π / 131,072, others to half of a step of 16 bits."""
    page, n = Page(pile, colour=pile.spins), pile.positions.shape[1]
    x, y = (page(f"Array.from(run.x, (_, i) => player.{axis}Of(run, i))") for axis in "xy")
    place = np.column_stack([x, y]).reshape(len(pile), n, 2)
    assert np.abs(place - pile.positions).max() <= 0.3 / 1999
    angle = page.array("run.angle").reshape(-1, n) * 2 * np.pi / 65536
    assert np.abs(np.exp(1j * angle) - np.exp(1j * pile.angles)).max() < 2 * np.pi / 131_000
    speed = np.hypot(*pile.velocities.transpose(2, 0, 1))
    top = page("run.topSpeed")
    assert top == speed.max()
    assert (
        np.abs(np.array(page("Array.from(run.speed, (_, i) => run.ways.speed[0](i))")).reshape(-1, n) - speed).max()
        <= top / 131_000
    )
    np.testing.assert_array_equal(
        page.array("run.radius"), np.tile(pile[0].bodies.radius.astype(np.float32), len(pile))
    )
    value = np.array(page("Array.from(run.colour, (_, i) => run.ways['your column'][0](i))")).reshape(-1, n)
    assert np.abs(value - pile.spins).max() <= np.ptp(pile.spins) / 131_000
    assert page("run.ways['your column'].slice(1, 3)") == [pile.spins.min(), pile.spins.max()]


def test_contacts_come_back_with_their_bodies_forces_and_ends(pile):
    page = Page(pile)
    np.testing.assert_array_equal(page.array("run.a"), pile.pairs[:, 0])
    np.testing.assert_array_equal(page.array("run.a") + page.array("run.b"), pile.pairs[:, 1])
    top, dt = page("run.topForce"), pile[0].dt
    for name, column in (("normal", 0), ("across", 1)):
        root = page.array(f"run.{name}") / 65535
        # A step of the root, 1 / 131,070 at most, is 2 √(f f_max) / 131,070 in the force.
        exact = pile.impulses[:, column] / dt
        bound = 2 * np.sqrt(np.abs(exact) * top) / 131_000 + top * 1e-10
        assert (np.abs(np.sign(root) * root**2 * top - exact) <= bound).all()
    last, k = pile[-1], len(pile) - 1
    c = last.contacts
    assert (c.body_b >= last.bodies.count + 4).any()
    for i in range(c.count):
        end = page(f"player.endOf(run, {k}, {c.body_a[i]}, {c.body_b[i]})")
        if c.body_b[i] >= last.bodies.count:  # a wall's or a segment's point lies half of the gap behind the contact
            expected = c.position[i] + 0.5 * c.separation[i] * c.normal[i]
        else:
            expected = last.bodies.position[c.body_b[i]]
        np.testing.assert_allclose(end, expected, atol=last.scales.wall_skin + 1e-3)  # ahead of which a wall is felt


def test_numbers_of_circles_and_segments_may_change(poured):
    page = Page(poured, colour=[[1.0], [2.0, 3.0, 4.0], [5.0]])
    assert page("run.offsets") == [0, 1, 4, 5]
    np.testing.assert_allclose(page("Array.from(run.x, (_, i) => player.xOf(run, i))"), [2, 2, 3.9, 7, 2], atol=1e-3)
    np.testing.assert_allclose(
        page("Array.from(run.colour, (_, i) => run.ways['your column'][0](i))"), [1, 2, 3, 4, 5], atol=1e-4
    )
    assert [page(f"player.stateAt(run, {t})") for t in (0.0, 0.49, 0.5, 1.9, 2.0, 9.0)] == [0, 0, 1, 1, 2, 2]
    assert page("player.circleAt(run, 1, 4.4, 1.2)") == 1
    assert page("player.circleAt(run, 0, 4.4, 1.2)") == -1
    assert "circle 2 · (7, 7) m" in page("player.described(run, 1, 2)")
    assert page("player.described(run, 0, 2)") == ""


def test_the_force_on_a_circle_is_the_sum_of_what_presses_on_it(pile):
    k, state = len(pile) - 1, pile[-1]
    c = state.contacts
    for i in (0, int(c.body_a[np.argmax(c.normal_impulse)])):
        mine = ((c.body_a == i) | (c.body_b == i)) & (c.normal_impulse > 0)
        total = c.normal_impulse[mine].sum() / state.dt
        found = re.search(r"pressed by ([\d.e-]+) N in (\d+) contact", Page(pile)(f"player.described(run, {k}, {i})"))
        assert float(found[1]) == pytest.approx(total, rel=2e-3)
        assert int(found[2]) == mine.sum()


def test_states_of_one_time_follow_each_other(poured):
    page = Page([state.replace(time=3.0) for state in poured])
    assert page("run.moments") == [0, 1 / 25, 2 / 25]
    assert page("run.times") == [3, 3, 3]


# ---- what it draws ----


@pytest.mark.parametrize("k", [0, 6, 12])
@pytest.mark.parametrize("zoom", [0, 1, 2])
def test_circles_lie_where_the_run_has_them_in_the_colour_of_their_speed(pile, k, zoom):
    page, state = Page(pile), pile[k]
    view = page.views(*state.bodies.position[20])[zoom]
    picture, seen = page.picture(k, view), 0
    speeds = np.hypot(*state.bodies.velocity.T) / page("run.topSpeed")
    centres = state.bodies.position
    for i, ((x, y), r, speed) in enumerate(zip(centres, state.bodies.radius, speeds)):
        colour = 255 * np.array(colormaps["viridis"](speed)[:3])
        for dx, dy in ((0, 0), (-0.5 * r, 0.0), (0.0, 0.5 * r)):
            row, column = pixel(view, x + dx, y + dy)
            ahead = np.arctan2(dy, dx) - state.bodies.angle[i]
            if 0 <= row < HIGH and 0 <= column < WIDE and (dx == dy == 0 or np.cos(ahead) < 0.8):
                seen += 1
                assert np.abs(picture[row, column] - colour).max() < 14
    others = np.random.default_rng(1).uniform((-3, 1), (12, 11), (300, 2))
    gaps = np.hypot(*(others[:, None] - centres).transpose(2, 0, 1)) - state.bodies.radius
    for x, y in others[(gaps > 1.6 / view["scale"]).all(axis=1)]:
        row, column = pixel(view, x, y)
        if 0 <= row < HIGH and 0 <= column < WIDE:
            assert (picture[row, column] == 255).all()
    assert seen >= 2


def test_the_colours_are_those_of_matplotlib(pile):
    shares = np.linspace(0, 1, 101)
    found = Page(pile)(f"{shares.tolist()}.map(player.colourAt)")
    np.testing.assert_allclose(found, 255 * colormaps["viridis"](shares)[:, :3], atol=7)


def test_ways_of_colouring_and_what_is_fixed(pile):
    state = pile[0]
    bodies = state.bodies._replace(mass=np.where(np.arange(state.bodies.count) == 3, np.inf, state.bodies.mass))
    page = Page([state.replace(bodies=bodies, contacts=None)])
    view = page.views(0, 0)[0]

    def centre(i, way):
        return page.picture(0, view, colour=way)[pixel(view, *state.bodies.position[i])]

    last = state.bodies.count - 1
    for way, first in (("radius", 1.0), ("index", 0.0)):
        for i, share in ((0, first), (last, 1.0 - first)):
            assert np.abs(centre(i, way) - 255 * np.array(colormaps["viridis"](share)[:3])).max() < 6
    assert (centre(3, "material") == 136).all()
    assert "fixed" in page("player.described(run, 0, 3)")
    assert page("Object.keys(run.ways)") == ["speed", "radius", "material", "index"]


def test_forces_are_lines_as_wide_as_they_are_strong(pile):
    """Across a line there are as many pixels of its colour as its force is strong: 6 for the strongest."""
    state = dc.find_contacts(circles_at([[3.0, 5.0], [5.0, 5.0], [8.0, 5.0], [10.0, 5.0]], box=(0, 0, 15, 10)))
    c = state.contacts
    assert c.count == 2
    state = state.replace(contacts=c._replace(normal_impulse=np.array([1.0, 0.5])))
    page = Page([state])
    view = page.views(0, 0)[0]
    plain, forces = page.picture(0, view), page.picture(0, view, forces=True)
    widths = []
    for x in (4.3, 9.3):
        _, column = pixel(view, x, 5.0)
        widths.append((np.abs(forces[:, column] - (213, 94, 0)).max(axis=1) < 40).sum())
        assert not (np.abs(plain[:, column] - (213, 94, 0)).max(axis=1) < 40).any()
    assert widths[0] == pytest.approx(6, abs=1)  # pixels of the widest
    assert widths[1] == pytest.approx(3, abs=1)


def test_closer_keeps_what_lies_under_the_pointer_and_the_scale_is_round(pile):
    page = Page(pile)
    view = {"x": 2.0, "y": 3.0, "scale": 20.0, "width": 300, "height": 200, "ratio": 1}
    here = page(f"player.toMetres({json.dumps(view)}, 40, 150)")
    closer = page(f"player.zoomed({json.dumps(view)}, 1.7, 40, 150)")
    np.testing.assert_allclose(page(f"player.toMetres({json.dumps(closer)}, 40, 150)"), here)
    assert [page(f"player.roundDown({value})") for value in (0.03, 4.99, 5.0, 19.0)] == pytest.approx([0.02, 2, 5, 10])


# ---- what is refused, and how large it is ----


def test_bad_input_is_refused_by_its_name(pile, poured, tmp_path, monkeypatch):
    lost = pile[0].bodies._replace(position=np.full_like(pile[0].bodies.position, np.nan))
    for states, options, why in (
        ([], {}, "states: expected at least one state"),
        ([poured[0], pile[0].replace(bodies=lost, contacts=None)], {}, r"states\[1\]: bodies.position\[0, 0\]"),
        (poured, {"colour": [[1.0]] * 2}, "colour: expected numbers for 3 states, got 2"),
        (poured, {"colour": [[1.0]] * 3}, r"colour\[1\]: expected finite numbers of shape \(3,\)"),
        (poured, {"colour": [[np.nan], [1.0] * 3, [1.0]]}, r"colour\[0\]"),
        (poured, {"fps": 25}, "fps: expected none for a page"),
        (poured, {"size": 100}, "size: expected none for a page"),
    ):
        with pytest.raises(ValueError, match=why):
            dc.film(states, tmp_path / "run.html", **options)
    with pytest.raises(ValueError, match=r"colour: expected finite numbers of shape \(13, 40\)"):
        pile.film(tmp_path / "run.html", colour=[1.0])
    with pytest.raises(ValueError, match="colour: expected none for a film"):
        dc.film(poured, tmp_path / "run.gif", colour=[[1.0], [1.0] * 3, [1.0]])
    monkeypatch.setattr(player, "MOST_CIRCLES", 4)
    with pytest.raises(ValueError, match=r"expected at most 4 circles in all of them together, got 5; .*every="):
        dc.film(poured, tmp_path / "run.html")
    assert not [*tmp_path.iterdir()]


def test_every_takes_the_columns_of_its_states(pile, tmp_path):
    page = pile.film(tmp_path / "run.html", every=5, colour=pile.spins).read_text()
    data = json.loads(re.search(r'application/json">(.*?)</script>', page)[1])
    assert data["times"] == [pile.times[i] for i in (0, 5, 10)]
    assert data["colours"] == [pile.spins[::5].min(), pile.spins[::5].max()]


@pytest.mark.parametrize(("n", "states", "most"), [(100, 120, 0.3e6), (1000, 60, 1.2e6)])
def test_a_page_is_small(n, states, most, tmp_path):
    """A fifth of the states of 1.5 MB and of 6 MB, with forces: circles in flight and contacts without order."""
    rng = np.random.default_rng(0)
    scene = dc.lattice_in_box(n, seed=0)
    moving = scene.bodies._replace(velocity=rng.normal(0, 5.0, (n, 2)))
    run = dc.simulate(scene.replace(bodies=moving), steps=states, record=1, solver=dc.PGS(sweeps=5)).trajectory
    assert run.film(tmp_path / "run.html").stat().st_size < most


HOSTILE = (
    "<script>alert(1)</script>",
    "</script><img src=x onerror=alert(1)>",
    "\"'`&<!--",
    "@DATA@ @SCRIPT@",
    "x" * 10_000,
    "\u2028\ud800",
)


@pytest.mark.parametrize("name", HOSTILE)
def test_a_name_is_text(poured, name):
    html = player.page([poured[0].replace(name=name)])
    html.encode()  # not even half of a pair of surrogates
    assert html.count("<script") == 2
    assert html.count("</script>") == 2
    data = json.loads(re.search(r'application/json">(.*?)</script>', html, re.S)[1])
    assert data["name"] == name
    assert "http" not in html.replace("http-equiv", "").replace(json.dumps(name), "")


# ---- in Chromium ----

CHROMIUM = next(filter(None, map(shutil.which, ("chromium", "chromium-browser", "google-chrome"))), None)
LISTEN = """<head>
<script>
const errors = [];
addEventListener("error", event => errors.push(String(event.message)));
for (const kind of ["error", "warn"]) console[kind] = (...words) => errors.push(words.join(" "));
addEventListener("securitypolicyviolation", event => errors.push("policy: " + event.blockedURI));
</script>
"""
"""Before all else of the page: the policy refuses what it would ask a network for, and says so."""

PROBE = """
<script>
const part = name => document.getElementById(name);
const settled = () => new Promise(done => requestAnimationFrame(() => requestAnimationFrame(done)));
const sent = (at, event) => { at.dispatchEvent(event); return settled(); };
const press = (key, more = {}) => sent(document.body, new KeyboardEvent("keydown", {key, bubbles: true, ...more}));
const clicked = name => { part(name).click(); return settled(); };
const counter = () => Number(part("clock").textContent.match(/· (\\d+) \\//)[1]);
const pixels = () => part("scene").toDataURL();
(async () => {
  let found = {};
  try {
    for (let i = 0; i < 500 && !part("clock").textContent; i++) await new Promise(done => setTimeout(done, 20));
    found = await (async () => { TEST })();
  } catch (error) { errors.push(String(error)); }
  const all = JSON.stringify({...found, errors});
  console.log("ANSWER" + btoa(unescape(encodeURIComponent(all))) + "END");
})();
</script>
"""


def in_chromium(states, tmp_path, test, **options):
    """What a script finds in the page, opened from disk; it must have no error and ask for nothing."""
    path = dc.film(states, tmp_path / "run.html", **options)
    page = path.read_text(encoding="utf-8").replace("<head>", LISTEN, 1) + PROBE.replace("TEST", test)
    path.write_text(page, encoding="utf-8")
    flags = ["--headless", "--no-sandbox", "--disable-gpu", "--disable-quic", "--no-first-run", "--disable-sync"]
    flags += ["--disable-background-networking", "--disable-component-update", "--window-size=800,700"]
    flags += [f"--user-data-dir={tmp_path / 'profile'}", "--enable-logging=stderr"]
    command = [CHROMIUM, *flags, path.as_uri()]
    with subprocess.Popen(command, stderr=subprocess.PIPE, text=True, errors="replace") as browser:
        stop = threading.Timer(120.0, browser.kill)
        stop.start()
        lines, answer = [], None
        for line in browser.stderr:
            lines.append(line)
            if answer := re.search("ANSWER([A-Za-z0-9+/=]*)END", line):
                break
        stop.cancel()
        browser.kill()
    assert answer, "".join(lines)[-3000:]
    found = json.loads(base64.b64decode(answer[1]))
    assert found.pop("errors") == []
    return found


needs_chromium = pytest.mark.skipif(CHROMIUM is None, reason="Chromium is not installed")


@needs_chromium
def test_keys_slider_colours_and_forces_work_in_chromium(pile, tmp_path):
    found = in_chromium(
        pile,
        tmp_path,
        """
        const steps = [counter()];
        await press("ArrowRight"); await press("ArrowRight"); steps.push(counter());
        await press("ArrowLeft"); steps.push(counter());
        part("slider").value = 8; await sent(part("slider"), new Event("input")); steps.push(counter());
        await press("End"); steps.push(counter()); await press("Home"); steps.push(counter());
        await press("End"); const plain = pixels(); await press("f"); const forces = pixels(); await clicked("forces");
        const again = pixels(); await press("c"); const radius = pixels();
        part("colour").value = "index"; part("colour").dispatchEvent(new Event("change")); await settled();
        const index = pixels(), high = part("high").textContent;
        await press("+"); const closer = pixels(); await press("0"); const whole = pixels();
        await press("ArrowRight", {shiftKey: true}); const moved = pixels();
        part("circle").value = "7"; part("circle").dispatchEvent(new Event("input")); await settled();
        await press("Home"); await press(" "); const label = part("play").textContent;
        await new Promise(done => setTimeout(done, 3000)); const end = counter();
        return {steps, forces: plain !== forces, off: plain === again, colours: new Set([plain, radius, index]).size,
          high, closer: closer !== index, whole: whole === index, moved: moved !== index,
          under: part("under").textContent,
          label, end, after: part("play").textContent, title: document.title};
        """,
    )
    assert found.pop("under").startswith("circle 7 · (")
    assert found.pop("high") == f"{pile.positions.shape[1] - 1} "
    assert found == {
        "steps": [1, 3, 2, 9, 13, 1], "forces": True, "off": True, "colours": 3, "closer": True, "whole": True,
        "moved": True, "label": "❚❚", "end": 13, "after": "▶", "title": "pile",
    }  # fmt: skip


@needs_chromium
def test_pixels_of_chromium_are_where_the_run_has_its_circles(pile, tmp_path):
    """Three states, three zooms: the colour at each centre that is in view, beside that of the speed."""
    found = in_chromium(
        pile,
        tmp_path,
        """
        const shots = [], canvas = part("scene"), context = canvas.getContext("2d");
        for (let zoom = 0; zoom < 3; zoom++) {
          for (const k of [0, 6, 12]) {
            part("slider").value = k; part("slider").dispatchEvent(new Event("input")); await settled();
            const shot = {k, zoom, width: canvas.width, height: canvas.height, rgb: []};
            const view = player.wholeView([-3, 1, 12, 11], canvas.width, canvas.height, devicePixelRatio);
            view.scale *= 1.25 ** (3 * zoom);
            for (const [x, y] of PLACES[k]) {
              const [u, v] = player.toPixels(view, x, y).map(Math.floor);
              const isUnderScale = u < 260 && v > canvas.height - 30;
              const isIn = u >= 0 && u < canvas.width && v >= 0 && v < canvas.height && !isUnderScale;
              shot.rgb.push(isIn ? [...context.getImageData(u, v, 1, 1).data].slice(0, 3) : null);
            }
            shots.push(shot);
          }
          for (let i = 0; i < 3; i++) await press("+");
        }
        return {shots};
        """.replace("PLACES", json.dumps({k: pile[k].bodies.position.tolist() for k in (0, 6, 12)})),
    )
    top = np.hypot(*pile.velocities.reshape(-1, 2).T).max()
    seen = [0, 0, 0]
    for shot in found["shots"]:
        speeds = np.hypot(*pile[shot["k"]].bodies.velocity.T) / top
        for rgb, speed in zip(shot["rgb"], speeds):
            if rgb is not None:
                seen[shot["zoom"]] += 1
                assert np.abs(np.array(rgb) - 255 * np.array(colormaps["viridis"](speed)[:3])).max() < 14
    assert seen[0] > 110
    assert seen[0] > seen[1] > seen[2] > 5


@needs_chromium
@pytest.mark.parametrize("name", HOSTILE)
def test_hostile_names_are_shown_as_text_in_chromium(poured, tmp_path, name):
    states = [state.replace(name=name) for state in poured]
    found = in_chromium(
        states,
        tmp_path,
        """
        return {name: part("name").textContent, images: document.images.length, scripts: document.scripts.length,
          wide: document.documentElement.scrollWidth <= innerWidth};
        """,
    )
    assert found == {"name": name, "images": 0, "scripts": 4, "wide": True}
