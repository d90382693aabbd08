"""The page as a browser shows it: a real Chromium without a window, which asks nobody but this machine."""

import io
import json
import os
import shutil
import sys

import numpy as np
import pytest
from PIL import Image

from levelflow import Box, extract
from levelflow.handles import handles_from
from levelflow.viewer.editing import Editing
from levelflow.viewer.page import standalone
from levelflow.viewer.server import Server
from levelflow.viewer.viewed import ViewedField
from tests.export.moving import growing, splitting
from tests.fields import Explicit

CHROMIUM = os.environ.get("LEVELFLOW_CHROMIUM") or shutil.which("chromium") or shutil.which("chromium-browser")


@pytest.fixture(scope="module")
def browser():
    playwright = pytest.importorskip("playwright.sync_api", reason="playwright is not installed")
    if CHROMIUM is None:
        pytest.skip("no Chromium: set LEVELFLOW_CHROMIUM")
    with playwright.sync_playwright() as tool:
        browser = tool.chromium.launch(
            executable_path=CHROMIUM, args=["--no-sandbox", "--use-angle=swiftshader", "--enable-unsafe-swiftshader"]
        )
        yield browser
        browser.close()


@pytest.fixture
def visit(browser):
    """Opens a page; in the end it must have had no errors, and have asked only where it came from."""
    pages = []

    def open_page(url, *, errors=0):
        page = browser.new_page(viewport={"width": 900, "height": 600})
        said, asked = [], []
        page.on("console", lambda message: said.append(message.text) if message.type == "error" else None)
        page.on("pageerror", lambda error: said.append(str(error)))
        page.on("request", lambda request: asked.append(request.url))
        page.goto(url)
        pages.append((page, url, said, asked, errors))
        settle(page)
        return page

    yield open_page
    for page, url, said, asked, errors in pages:
        assert len(said) == errors, said
        assert asked[0] == url and all(address.startswith((url, "data:", "blob:")) for address in asked)
        page.close()


@pytest.fixture
def serve():
    servers = []

    def start(*viewed, resolution=24, editing=None):
        server = Server(viewed, resolution=resolution, preview=16, editing=editing)
        server.start()
        servers.append(server)
        return server.url

    yield start
    for server in servers:
        server.close()


def settle(page):
    """Until the frame that is wanted is drawn, at rest."""
    page.wait_for_selector("body[data-ready=true]", timeout=30_000)
    page.wait_for_timeout(700)


def picture(page):
    """What is drawn, without the words on it."""
    page.evaluate("document.getElementById('labels').style.visibility = 'hidden'")
    return np.asarray(Image.open(io.BytesIO(page.locator("#canvas").screenshot())).convert("RGB")).astype(int)


def covered(image, left=0.0, right=0.75):
    """The share of pixels that are not ground, away from the tools."""
    part = image[:, int(left * image.shape[1]) : int(right * image.shape[1])]
    return float((np.abs(part - [251, 250, 247]).max(2) > 12).mean())


def move(page, place):
    page.locator(".time input[type=range]").first.fill(str(place))
    settle(page)


def two_parameters():
    """A ball of radius t1 at x = t2."""

    def f(x, t):
        return (x[:, 0] - t[:, 1]) ** 2 + x[:, 1] ** 2 + x[:, 2] ** 2 - t[:, 0] ** 2

    return Explicit(f, 3, 2, box=Box((-1.0,) * 3, (1.0,) * 3, ((0.3, 0.5), (-0.4, 0.4))))


def test_the_slider_changes_the_surface(visit, serve):
    page = visit(serve(ViewedField(growing(), name="ball")))
    assert (
        page.locator(".note").inner_text().startswith("There is no surface at t = -4") and covered(picture(page)) == 0
    )
    move(page, 40)
    page.keyboard.press("r")
    settle(page)
    before = picture(page)
    move(page, 36)
    after = picture(page)
    # The radius is 1/2 + t/4 at t = -4 + 5 k / 48.
    ratio = ((0.5 + (-4 + 5 * 36 / 48) / 4) / (0.5 + (-4 + 5 * 40 / 48) / 4)) ** 2
    assert covered(after) / covered(before) == pytest.approx(ratio, rel=0.1)
    assert page.locator("body").get_attribute("data-time") == "-0.25"


def test_a_frame_that_is_there_is_swapped_at_once(visit, serve):
    page = visit(serve(ViewedField(splitting(), name="two")))
    for place in (10, 20, 10, 20):
        move(page, place)
    swaps = page.evaluate("viewer.swaps")
    assert len(swaps) >= 2 and min(swaps) < 50


def test_keys_step_play_and_reset(visit, serve):
    page = visit(serve(ViewedField(splitting(), name="two")))
    home = picture(page)
    page.mouse.move(300, 300)
    page.mouse.down()
    page.mouse.move(420, 240, steps=3)
    page.mouse.up()
    settle(page)
    turned = np.abs(picture(page) - home).mean()
    page.keyboard.press("r")
    settle(page)
    # The first picture frames the preview.
    assert turned > 1 and np.abs(picture(page) - home).mean() < turned / 5
    page.keyboard.press("ArrowRight")
    page.keyboard.press("ArrowRight")
    page.keyboard.press("ArrowLeft")
    settle(page)
    assert float(page.locator("body").get_attribute("data-time")) == pytest.approx(0.8 / 48, rel=1e-6)
    page.keyboard.press(" ")
    page.wait_for_timeout(2000)
    page.keyboard.press(" ")
    settle(page)
    assert float(page.locator("body").get_attribute("data-time")) > 2 * 0.8 / 48


def test_colours_cuts_and_level_sets(visit, serve):
    page = visit(serve(ViewedField(growing().at(0.0), name="ball")))
    clay = picture(page)
    page.select_option("#colour", "curvature")
    settle(page)
    coloured = picture(page)
    assert np.abs(coloured - clay).max() > 50 and "1/length" in page.locator("#legend").inner_text()
    page.select_option("#colour", "")
    page.click("#axes button[data-axis='2']")
    settle(page)
    levels = picture(page)
    page.click("#contours")
    settle(page)
    opened = picture(page)
    assert np.abs(levels - opened).max() > 50
    # The inside has the colour of the inside: more blue than red.
    middle = opened[opened.shape[0] // 2, opened.shape[1] // 2]
    assert middle[2] > middle[0] and clay[clay.shape[0] // 2, clay.shape[1] // 2][0] > 100
    assert page.locator("#where").inner_text() == "z = 0"


def test_distances_are_in_the_units_of_the_file(visit, serve):
    center = (300.0, -20.0, 5.0)
    page = visit(serve(ViewedField(growing(center).at(1.0), name="ball")))
    page.keyboard.press("m")
    # The camera turns about the middle of the sphere, so this is the point nearest to it; the other is at the top.
    box = page.locator("#canvas").bounding_box()
    page.mouse.click(box["width"] / 2, box["height"] / 2)
    page.evaluate(
        "viewer.points.push({pane: viewer.panes[0], point: viewer.points[0].point.map(c => -c)}), viewer.redraw()"
    )
    settle(page)
    assert float(page.locator("#measured strong").inner_text()) == pytest.approx(1.5, abs=0.02)
    assert page.locator("#overlay circle").count() == 2


def test_times_can_be_typed_and_wrong_ones_are_answered(visit, serve):
    page = visit(serve(ViewedField(splitting(), name="two")))
    box = page.locator(".time input[type=text]")
    box.fill("0.1234")
    box.press("Enter")
    settle(page)
    assert page.locator("body").get_attribute("data-time") == "0.1234" and covered(picture(page)) > 0.02
    box.fill("soon")
    box.press("Enter")
    assert "“soon” is not a number; type a time from 0 to 0.8" in page.locator("#message").inner_text()


def test_a_curve_in_the_plane_lies_among_its_level_sets(visit, serve):
    page = visit(serve(ViewedField(growing(space=2).at(0.0), name="disc")))
    levels = picture(page)
    page.click("#contours")
    settle(page)
    assert covered(picture(page)) < 0.1 < covered(levels)


def test_fields_stand_side_by_side_with_one_camera(visit, serve):
    page = visit(serve(ViewedField(two_parameters(), name="a"), ViewedField(two_parameters(), name="b")))
    assert page.locator(".time").count() == 2
    page.evaluate("document.getElementById('tools').style.display = 'none'")
    image = picture(page)
    half = image.shape[1] // 2
    assert covered(image, 0, 0.5) == pytest.approx(covered(image, 0.5, 1.0), rel=0.05) and covered(image) > 0.02
    page.locator(".time input[type=range]").nth(1).fill("48")
    settle(page)
    moved = picture(page)
    assert np.abs(moved[:, :half] - image[:, :half]).max() > 50 and np.abs(moved[:, half:] - image[:, half:]).max() > 50


def mixture():
    """Balls whose radius is 0.2 of a, 0.4 of b and 0.6 of c."""

    def f(x, t):
        return x.norm(dim=1) - 0.2 - 0.2 * t[:, 0] - 0.4 * t[:, 1]

    field = Explicit(f, 3, 2, box=Box((-1.0,) * 3, (1.0,) * 3, ((0.0, 1.0), (0.0, 1.0))))
    field.provenance = {"shares": ["a", "b", "c"]}
    return field


def test_shares_of_a_mixture_stay_shares(visit, serve):
    page = visit(serve(ViewedField(mixture(), name="mixture")))
    assert page.locator(".time b").all_inner_texts() == ["b", "c"]
    first, second = page.locator(".time input[type=range]").all()
    first.fill("24")
    second.fill("36")
    settle(page)
    assert page.locator("body").get_attribute("data-time") == "0.25,0.75" and first.input_value() == "12"
    assert page.locator(".label p").first.inner_text().endswith("a 0")
    page.locator(".time input[type=text]").nth(1).fill("0.9")
    page.keyboard.press("Enter")
    settle(page)
    assert page.locator("body").get_attribute("data-time") == "0.1,0.9"
    second.fill("0")
    settle(page)
    assert page.locator("body").get_attribute("data-time") == "0.1,0"
    # What is prepared is what will be shown.
    shown = page.evaluate("[...viewer.panes[0].frames.values()].map((frame) => frame.values)")
    assert len(shown) > 4 and all(b + c <= 1 + 1e-9 for b, c in shown)
    assert page.evaluate(
        "viewer.shares = ['a', 'b', 'c', 'd'], viewer.values = [0.5, 0.3, 0.2], viewer.moved(2, 0.6)"
    ) == [
        0.25,
        0.15,
        0.6,
    ]


def test_files_leave_by_buttons_and_what_is_wrong_is_said(visit, serve, monkeypatch):
    page = visit(serve(ViewedField(growing().at(0.0), name="ball"), resolution=16), errors=1)
    with page.expect_download() as download:
        page.click("#formats button:text('PLY')")
    assert download.value.suggested_filename == "ball.ply"
    with page.expect_download() as download:
        page.click("#formats button:text('PNG')")
    with Image.open(download.value.path()) as image:
        assert image.size[0] >= 900
    monkeypatch.setitem(sys.modules, "pxr.Usd", None)
    page.click("#formats button:text('USD')")
    page.wait_for_selector("#message:not([hidden])")
    assert "pip install 'levelflow[usd]'" in page.locator("#message").inner_text()


def test_a_file_needs_no_server(visit, tmp_path):
    file = tmp_path / "two.html"
    file.write_text(standalone([ViewedField(splitting(), name="two")], [0.0, 0.2, 0.5], resolution=24), "utf-8")
    page = visit(file.as_uri())
    before = picture(page)
    move(page, 2)
    after = picture(page)
    assert np.abs(after - before).max() > 50 and 0.02 < covered(after) < covered(before)
    page.click("#axes button[data-axis='2']")
    settle(page)
    assert np.abs(picture(page) - after).max() > 50
    with page.expect_download() as download:
        page.click("#formats button:text('PLY')")
    assert (tmp_path / download.value.suggested_filename).name == "two_t=0.5.ply"


BOTTOM = {"name": "foot", "region": {"box": {"lower": [-1, -1, -1], "upper": [1, -0.3, 1]}}, "freeze": True}


@pytest.fixture
def edit(visit, serve, tmp_path):
    """Opens the page of a ball of the radius 1/2 with handles that there are already, and the file that they are in."""

    def open_page(*there, space=3, errors=0):
        still = growing(space=space).at(0.0)
        file = tmp_path / "handles.json"
        if there:
            file.write_text(json.dumps({"handles": there}))
        editing = Editing(extract(still, resolution=24), file, command="levelflow edit ball --handles handles.json")
        page = visit(serve(ViewedField(still, name="ball"), editing=editing), errors=errors)
        computed(page)
        return page, file

    return open_page


def computed(page):
    """Until the surface after the edit is there, or it is said why not."""
    page.wait_for_selector("body[data-preview=idle], body[data-preview=wrong]", timeout=30_000)
    page.wait_for_timeout(100)
    page.wait_for_selector("body[data-preview=idle], body[data-preview=wrong]", timeout=30_000)


def listed(page):
    """The handles as they would be saved."""
    return page.evaluate("JSON.parse(viewer.editing.text()).handles")


def middle(page):
    box = page.locator("#canvas").bounding_box()
    return box["width"] / 2, box["height"] / 2


def pull(page, start, end):
    page.mouse.move(*start)
    page.mouse.down()
    page.mouse.move(*end, steps=4)
    page.mouse.up()
    computed(page)


def test_a_handle_is_placed_dragged_undone_and_saved(edit):
    page, file = edit(BOTTOM)
    assert page.locator("#command code").inner_text() == "levelflow edit ball --handles handles.json"
    settle(page)
    bare = picture(page)
    x, y = middle(page)
    page.mouse.click(x, y)
    computed(page)
    _, placed = listed(page)
    center, radius = np.array(placed["region"]["sphere"]["center"]), placed["region"]["sphere"]["radius"]
    back = np.array(page.evaluate("viewer.camera.axes.back"))
    assert np.allclose(center, 0.5 * back, atol=0.02) and placed["move"] == [0, 0, 0]
    settle(page)
    # Orange where the ball is, and blue where the surface is held.
    red, _, blue = (picture(page) - bare)[int(y), int(x)]
    assert red - blue > 60
    pull(page, (x, y), (x + 60, y - 40))
    move = np.array(listed(page)[1]["move"])
    assert abs(move @ back) < 1e-4 and np.linalg.norm(move) > 0.1
    there = page.evaluate("viewer.editing.project(toPage(viewer.editing.handle.place, viewer.panes[0].meta))")
    assert np.allclose(there, (x + 60, y - 40), atol=1)
    # The surface goes along where it is held, and the foot stays.
    after = np.array(list(page.evaluate("[...viewer.editing.after.position]"))).reshape(-1, 3)
    rest = np.array(list(page.evaluate("[...viewer.editing.after.rest]"))).reshape(-1, 3)
    held = np.linalg.norm(rest - center, axis=1) < radius
    assert held.sum() > 5 and np.allclose(after[held] - rest[held], move, atol=1e-5)
    assert np.allclose(after[rest[:, 1] < -0.31], rest[rest[:, 1] < -0.31], atol=1e-5)
    page.keyboard.press("Control+z")
    computed(page)
    assert listed(page)[1] == placed
    page.keyboard.press("Control+Shift+z")
    computed(page)
    assert "●" in page.locator("#keep").inner_text()
    page.keyboard.press("Control+s")
    page.wait_for_selector("#message:not([hidden])")
    assert page.locator("#message").inner_text() == "handles.json is saved."
    assert "●" not in page.locator("#keep").inner_text()
    fixed, moved = handles_from(file)
    assert fixed.name == "foot" and np.allclose(moved.by, move)


def test_handles_move_along_axes_and_the_normal_and_turn(edit):
    page, _ = edit(BOTTOM)
    x, y = middle(page)
    page.mouse.click(x, y)
    back = np.array(page.evaluate("viewer.camera.axes.back"))
    page.mouse.move(x, y)
    for key in "gy":
        page.keyboard.press(key)
    page.mouse.move(x + 30, y - 80, steps=3)
    page.keyboard.press("Enter")
    computed(page)
    move = listed(page)[1]["move"]
    assert move[0] == move[2] == 0 and move[1] > 0.1
    page.keyboard.press("Control+z")
    # Along the normal, which here almost points at the eye: from beside it the handle comes out.
    page.evaluate("viewer.camera.turn(-1, 0), viewer.redraw()")
    start = page.evaluate("viewer.editing.project(toPage(viewer.editing.handle.place, viewer.panes[0].meta))")
    page.mouse.move(*start)
    page.mouse.down()
    page.keyboard.down("Shift")
    page.mouse.move(start[0] + (80 if start[0] > x else -80), start[1], steps=3)
    page.mouse.up()
    page.keyboard.up("Shift")
    computed(page)
    move = np.array(listed(page)[1]["move"])
    assert move @ back > 0.99 * np.linalg.norm(move) > 0.1
    page.keyboard.press("Control+z")
    # A quarter of a turn about what the eye looks along, counter-clockwise.
    start = page.evaluate("viewer.editing.project(toPage(viewer.editing.handle.place, viewer.panes[0].meta))")
    page.mouse.move(start[0] + 80, start[1])
    page.keyboard.press("r")
    page.mouse.move(start[0] + 60, start[1] - 60)
    page.mouse.move(start[0], start[1] - 80)
    page.mouse.click(start[0], start[1] - 80)
    computed(page)
    turn = listed(page)[1]["rotate"]
    assert turn["angle"] == pytest.approx(90, abs=0.1) and "move" not in listed(page)[1]
    assert np.allclose(turn["axis"], page.evaluate("viewer.camera.axes.back"), atol=1e-5)
    # Another quarter about the same axis, given up with Escape.
    page.keyboard.press("r")
    page.mouse.move(start[0] - 80, start[1])
    page.keyboard.press("Escape")
    computed(page)
    assert listed(page)[1]["rotate"] == turn
    # The surface as well is as it was before.
    before = page.evaluate("[...viewer.editing.after.position]")
    page.keyboard.press("g")
    page.mouse.move(start[0] - 80, start[1] - 30)
    page.wait_for_timeout(600)
    page.keyboard.press("Escape")
    computed(page)
    assert page.evaluate("[...viewer.editing.after.position]") == before
    assert page.locator("#kinds .on").inner_text() == "turn"


def test_turns_one_after_the_other_are_one_turn(edit):
    page, _ = edit(BOTTOM)
    p, (a, first), (b, second) = [0.3, -0.2, 0.9], ([1, 2, 3], 70), ([-1, 0, 0.5], 155)
    once = page.evaluate("([p, a, b]) => turned(turned(p, ...a), ...b)", [p, [a, first], [b, second]])
    both = page.evaluate("([p, a, b]) => turned(p, ...composed(a, b))", [p, [a, first], [b, second]])
    assert np.allclose(once, both, atol=1e-12) and np.linalg.norm(both) == pytest.approx(np.linalg.norm(p))
    assert page.evaluate("composed([[0, 0, 2], 300], [[0, 0, -1], -100])") == [[0, 0, -1], -400]


def test_radii_kinds_and_deletion(edit):
    page, _ = edit(BOTTOM)
    x, y = middle(page)
    page.mouse.click(x, y)
    radius = listed(page)[1]["region"]["sphere"]["radius"]
    page.mouse.move(x, y)
    page.mouse.wheel(0, -100)
    page.wait_for_timeout(500)
    computed(page)
    assert listed(page)[1]["region"]["sphere"]["radius"] == pytest.approx(radius * np.exp(1 / 8), rel=1e-3)
    distance = page.evaluate("viewer.camera.distance")
    page.mouse.move(40, 300)
    page.mouse.wheel(0, -100)
    assert page.evaluate("viewer.camera.distance") < distance
    page.click("#kinds [data-kind=hold]")
    assert listed(page)[1]["freeze"] is True and page.locator("#handles li").count() == 2
    page.keyboard.press("Delete")
    assert listed(page) == [BOTTOM]
    page.click("#handles li button:text('×')")
    computed(page)
    assert listed(page) == [] and "Click the surface to place a handle" in page.locator("#note").inner_text()


def test_handles_that_cannot_be_met_are_answered_on_the_page(edit):
    high = {"region": {"sphere": {"center": [0, 0.5, 0], "radius": 0.98}}, "move": [0, 0.1, 0]}
    page, file = edit(BOTTOM, high, errors=1)
    note = page.locator("#note")
    assert (
        note.inner_text().startswith("Handle 1 ('foot') and handle 2 both hold") and page.locator(".wrong").count() == 3
    )
    page.locator("#handles .name").nth(1).click()
    page.fill("#numbers input >> nth=1", "much")
    page.keyboard.press("Enter")
    assert page.locator("#message").inner_text() == "Type numbers, such as 0.25."
    page.evaluate("viewer.editing.resize(0.3), viewer.editing.changed()")
    computed(page)
    assert note.inner_text() == "" and page.locator(".wrong").count() == 0
    before = file.read_text()
    page.evaluate("viewer.editing.list = []")
    page.keyboard.press("Control+s")
    page.wait_for_selector("#message:has-text('There are no handles; click the surface')")
    assert file.read_text() == before


def test_a_curve_in_the_plane_has_handles_too(edit):
    page, file = edit({"region": {"box": {"lower": [-1, -1], "upper": [1, -0.3]}}, "freeze": True}, space=2)
    top = page.evaluate("viewer.editing.project([0, 0.5, 0])")
    page.mouse.click(*top)
    computed(page)
    pull(page, top, (top[0], top[1] - 50))
    page.keyboard.press("Control+s")
    page.wait_for_selector("#message:not([hidden])")
    _, moved = handles_from(file)
    assert np.allclose(moved.region.center, (0, 0.5), atol=0.03) and moved.by[1] > 0.05 and abs(moved.by[0]) < 0.01
    highest = page.evaluate(
        "viewer.editing.after.position.reduce((most, y, i) => (i % 3 === 1 ? Math.max(most, y) : most), -1)"
    )
    assert highest == pytest.approx(0.5 + moved.by[1], abs=0.03)


def test_a_file_places_handles_and_hands_them_over(visit, tmp_path):
    still = growing().at(0.0)
    editing = Editing(extract(still, resolution=16), tmp_path / "handles.json", command="levelflow edit ball")
    file = tmp_path / "ball.html"
    file.write_text(standalone([ViewedField(still, name="ball")], [], resolution=24, editing=editing), "utf-8")
    page = visit(file.as_uri())
    page.mouse.click(*middle(page))
    assert page.locator("#showing").is_hidden()
    with page.expect_download() as download:
        page.click("#keep")
    assert download.value.suggested_filename == "handles.json"
    (handle,) = handles_from(download.value.path())
    assert np.linalg.norm(handle.region.center) == pytest.approx(0.5, abs=0.01)
