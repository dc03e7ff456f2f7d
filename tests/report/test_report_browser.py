"""The report in a real browser: what a reader sees and does."""

import base64
import json
import os
import shutil
from pathlib import Path

import numpy as np
import pytest

from report.run_folders import (
    CLOSE_RUNS,
    World,
    add_identification,
    fit_parameters,
    make_close,
    make_fit,
    make_run,
    many_parameters,
    simulate,
)
from report.test_report_augment import evaluation
from trueup.report import write_report

pytestmark = pytest.mark.browser

OPTIONS = (
    "--headless=new",
    "--no-sandbox",
    "--disable-gpu",
    "--disable-dev-shm-usage",
    "--disable-background-networking",
    "--disable-component-update",
    "--no-first-run",
    "--force-device-scale-factor=1",
    "--force-prefers-reduced-motion",  # a click must not chase a page that still scrolls
)


def program(*names):
    """A browser program; without it the tests are skipped, in CI they fail."""
    found = next((path for path in map(shutil.which, names) if path), None)
    if found is None:
        message = f"{names[0]} is not installed: apt-get install chromium chromium-driver"
        if os.environ.get("CI"):
            pytest.fail(message)
        pytest.skip(message)
    return found


@pytest.fixture(scope="module")
def driver():
    browser, chromedriver = program("chromium", "chromium-browser", "google-chrome"), program("chromedriver")
    webdriver = pytest.importorskip("selenium.webdriver", reason="selenium is in the extra report-test")
    options = webdriver.ChromeOptions()
    options.binary_location = browser
    for option in OPTIONS:
        options.add_argument(option)
    options.set_capability("goog:loggingPrefs", {"browser": "ALL", "performance": "ALL"})
    service = webdriver.ChromeService(executable_path=chromedriver)
    window = webdriver.Chrome(options=options, service=service)
    window.set_script_timeout(30)
    yield window
    window.quit()


@pytest.fixture(scope="module")
def page(run_folder, tmp_path_factory) -> Path:
    return write_report(run_folder, tmp_path_factory.mktemp("page") / "report.html")


def view(driver, width, height=900, *, mobile=False):
    size = {"width": width, "height": height, "deviceScaleFactor": 2 if mobile else 1, "mobile": mobile}
    driver.execute_cdp_cmd("Emulation.setDeviceMetricsOverride", size)


def show(driver, page, width=1280, *, mobile=False):
    view(driver, width, mobile=mobile)
    for kind in ("browser", "performance"):
        driver.get_log(kind)
    driver.get(page.as_uri())
    wait_for(driver, "return document.querySelectorAll('#trace-figure .scatterlayer .trace').length > 0")


def wait_for(driver, script):
    from selenium.webdriver.support.ui import WebDriverWait

    WebDriverWait(driver, 20).until(lambda window: window.execute_script(script))


def problems(driver):
    return [entry["message"] for entry in driver.get_log("browser") if entry["level"] in ("SEVERE", "WARNING")]


def requests(driver):
    messages = [json.loads(entry["message"])["message"] for entry in driver.get_log("performance")]
    sent = [item["params"] for item in messages if item["method"] == "Network.requestWillBeSent"]
    return [item["request"]["url"] for item in sent]


def curves(driver):
    """Name, axis, and first, middle and last value of every curve that is drawn."""
    return driver.execute_script(
        "return document.getElementById('trace-figure').data.map((curve) => [curve.name, curve.yaxis || 'y',"
        " curve.y.length, curve.y[0], curve.y[curve.y.length >> 1], curve.y[curve.y.length - 1]])"
    )


def paths(driver):
    script = "return [...document.querySelectorAll('#trace-figure .scatterlayer path.js-line')].map((p) => p.getAttribute('d'))"
    return driver.execute_script(script)


def choose(driver, name, text):
    from selenium.webdriver.support.ui import Select

    Select(driver.find_element("id", f"trace-{name}")).select_by_visible_text(text)


def screenshot(driver, path):
    size = driver.execute_script("const e = document.documentElement; return [e.clientWidth, e.scrollHeight]")
    clip = {"x": 0, "y": 0, "width": size[0], "height": size[1], "scale": 1}
    command = {"format": "png", "captureBeyondViewport": True, "clip": clip}
    path.write_bytes(base64.b64decode(driver.execute_cdp_cmd("Page.captureScreenshot", command)["data"]))
    assert path.read_bytes().startswith(b"\x89PNG")
    assert path.stat().st_size > 50_000


@pytest.mark.long
def test_it_opens_without_errors_and_without_the_network(driver, page, tmp_path):
    show(driver, page)
    figures = driver.execute_script(
        "return [...document.querySelectorAll('.figure')].map((e) => e.data ? e.data.length : 0)"
    )
    assert len(figures) == 7
    assert all(figures)
    screenshot(driver, tmp_path / "desktop.png")
    assert problems(driver) == []
    urls = requests(driver)
    assert page.as_uri() in urls
    assert all(url.startswith(("file:", "data:", "blob:")) for url in urls)


@pytest.mark.long
def test_curves_and_residuals_are_drawn(driver, page):
    show(driver, page)
    drawn = curves(driver)
    assert [name for name, axis, *_ in drawn if axis == "y"] == ["measured", "command", "mujoco/stock", "mujoco/fitted"]
    assert [name for name, axis, *_ in drawn if axis == "y2"] == [
        "residual command",
        "residual mujoco/stock",
        "residual mujoco/fitted",
    ]
    assert len(paths(driver)) == 7
    by_name = {name: values for name, _, *values in drawn}
    for run in ("command", "mujoco/stock", "mujoco/fitted"):
        for row in (1, 2, 3):
            expected = by_name["measured"][row] - by_name[run][row]
            assert by_name[f"residual {run}"][row] == pytest.approx(expected, abs=1e-6)


@pytest.mark.long
def test_drawn_values_are_those_of_the_recording(driver, page, run_folder):
    from trueup.core.traces import TraceSet

    show(driver, page)
    choose(driver, "episode", "chirp_sweep")
    choose(driver, "joint", "gripper")
    traces = TraceSet.load(run_folder).episodes["chirp_sweep"].traces
    trace = next(item for item in traces if (item.signal, item.joint) == ("position", "gripper"))
    drawn = driver.execute_script(
        "return Object.fromEntries(document.getElementById('trace-figure').data.map((own) => [own.name, Array.from(own.y)]))"
    )
    measured = trace.curves["measured"]
    assert drawn["measured"] == pytest.approx(measured.tolist(), abs=float(np.ptp(measured)) / 16_000)
    away = measured - trace.curves["mujoco/stock"]
    assert drawn["residual mujoco/stock"] == pytest.approx(away.tolist(), abs=float(np.ptp(away)) / 16_000 + 1e-6)


@pytest.mark.long
def test_each_menu_changes_the_curves(driver, page):
    show(driver, page)
    for menu, text in (("episode", "pick_place"), ("joint", "gripper"), ("signal", "torque")):
        before, lines = curves(driver), paths(driver)
        choose(driver, menu, text)
        assert curves(driver) != before
        assert paths(driver) != lines
        assert text in driver.find_element("id", "trace-figure").get_attribute("aria-label")
    assert problems(driver) == []


@pytest.mark.long
def test_a_run_can_be_hidden_and_degrees_shown(driver, page):
    show(driver, page)
    radians = curves(driver)
    driver.find_element("css selector", "#trace-runs input[value='mujoco/stock']").click()
    assert {name for name, *_ in curves(driver)} == {name for name, *_ in radians if "stock" not in name}
    driver.find_element("id", "trace-degrees").click()
    assert curves(driver)[0][3] == pytest.approx(radians[0][3] * 57.29578, rel=1e-5)
    assert "[deg]" in driver.execute_script("return document.getElementById('trace-figure').layout.yaxis.title.text")


@pytest.mark.long
def test_the_keyboard_changes_motion_and_joint(driver, page):
    from selenium.webdriver.common.keys import Keys

    show(driver, page)
    figure = driver.find_element("id", "trace-figure")
    label = figure.get_attribute("aria-label")
    figure.send_keys(Keys.ARROW_RIGHT)
    after = figure.get_attribute("aria-label")
    assert after.split(" in motion ")[1] != label.split(" in motion ")[1]
    figure.send_keys(Keys.ARROW_DOWN)
    assert figure.get_attribute("aria-label").split(" in motion ")[0] != after.split(" in motion ")[0]
    joint = driver.find_element("id", "trace-joint")
    chosen = joint.get_property("value")
    joint.send_keys(Keys.HOME)
    joint.send_keys(Keys.ARROW_DOWN)
    assert joint.get_property("value") in ("elbow_flex", chosen)
    assert joint.get_property("value") in figure.get_attribute("aria-label")


@pytest.mark.long
def test_a_flag_opens_its_trace_and_is_marked_there(driver, page):
    show(driver, page)
    row = driver.find_element("css selector", "#flags tr[data-trace-joint='elbow_flex'] button")
    row.click()
    label = driver.find_element("id", "trace-figure").get_attribute("aria-label")
    assert label.startswith("torque of joint elbow_flex in motion single_joint_wrist_roll")
    # the recording starts at 5 s, the flag spans 9.1 to 10.5 s
    (mark,) = driver.execute_script("return document.getElementById('trace-figure').layout.shapes")
    assert (mark["x0"], mark["x1"]) == pytest.approx((4.1, 5.5))
    assert "torque stays at 10.0 Nm" in driver.find_element("id", "trace-flags").text


def test_motions_are_sorted_worst_first_and_open_their_trace(driver, page):
    show(driver, page)

    def column(number):
        script = "return [...document.querySelectorAll('#episodes tbody tr')].map((r) => r.cells[arguments[0]].dataset.value)"
        return [float(value) for value in driver.execute_script(script, number)]

    assert column(4) == sorted(column(4), reverse=True)
    header = driver.find_element("css selector", "#episodes th:nth-child(3) button")
    header.click()
    assert column(2) == sorted(column(2), reverse=True)
    header.click()
    assert column(2) == sorted(column(2))
    first = driver.find_element("css selector", "#episodes tbody tr button")
    name = first.text
    first.click()
    assert f"in motion {name}:" in driver.find_element("id", "trace-figure").get_attribute("aria-label")


def test_menus_swap_tables_and_bars(driver, page, run_folder):
    from selenium.webdriver.support.ui import Select

    from trueup.core.results import GapResult

    show(driver, page)
    server_side = driver.execute_script("return document.querySelector('#joints [data-table=joints]').innerText")
    split, signal, metric = driver.find_elements("css selector", "#joints select")
    Select(split).select_by_value("train")
    Select(signal).select_by_value("velocity")
    changed = driver.execute_script("return document.querySelector('#joints [data-table=joints]').innerText")
    result = GapResult.load(run_folder / "gap.json").runs["mujoco/stock"]["train"]["velocity"]["rmse"]
    assert f"{result.per_joint['gripper'].value:#.3g}\N{NO-BREAK SPACE}rad/s" in changed
    # The command holds no velocity: its column is gone, and paired comparisons are of position only.
    assert "command" not in changed
    assert driver.execute_script("return document.querySelector('#joints [data-table=pairs]').hidden")
    Select(signal).select_by_value("position")
    Select(split).select_by_value("test")
    assert metric.get_property("value") == "rmse"
    again = driver.execute_script("return document.querySelector('#joints [data-table=joints]').innerText")
    assert again.split() == server_side.split()


@pytest.mark.long
def test_it_fits_a_phone(driver, page, tmp_path):
    show(driver, page, 390, mobile=True)
    wide, narrow = driver.execute_script("const e = document.documentElement; return [e.scrollWidth, e.clientWidth]")
    assert narrow == 390
    assert wide <= narrow
    sticking_out = driver.execute_script(
        "return [...document.querySelectorAll('main *')].filter((e) => !e.closest('.scroll') && !e.closest('svg')"
        " && e.getBoundingClientRect().right > 391).map((e) => e.outerHTML.slice(0, 80))"
    )
    assert sticking_out == []
    screenshot(driver, tmp_path / "phone.png")


@pytest.mark.long
def test_dark_theme_redraws_the_figures(driver, page):
    show(driver, page)

    def measured_color():
        return driver.execute_script("return document.getElementById('trace-figure').data[0].line.color")

    light = measured_color()
    driver.execute_cdp_cmd(
        "Emulation.setEmulatedMedia", {"features": [{"name": "prefers-color-scheme", "value": "dark"}]}
    )
    try:
        wait_for(driver, f"return document.getElementById('trace-figure').data[0].line.color !== '{light}'")
        assert measured_color() != light
    finally:
        driver.execute_cdp_cmd("Emulation.setEmulatedMedia", {"features": []})


@pytest.mark.long
def test_it_prints(driver, page):
    show(driver, page)
    assert base64.b64decode(driver.print_page()).startswith(b"%PDF")
    wait_for(driver, "return document.getElementById('trace-figure').offsetWidth > 900")
    assert problems(driver) == []


@pytest.mark.long
def test_hostile_names_are_only_text(driver, tmp_path):
    joints = ("</script><script>window.hacked=1</script>", "<img src=x onerror='window.hacked=2'>", "__proto__")
    names = tuple(f"{number} <svg onload='window.hacked=3'> constructor" for number in range(8))
    runs = ("x/<i>stock</i>", "toString")
    world = World(joints=joints, scored=joints[:2], runs=runs, names=names, samples=120)
    page = write_report(make_run(tmp_path / "run", world))
    show(driver, page)
    for joint in joints:
        choose(driver, "joint", joint)
        assert joint in driver.find_element("id", "trace-figure").get_attribute("aria-label")
    from selenium.webdriver.support.ui import Select

    Select(driver.find_elements("css selector", "#joints select")[0]).select_by_value("all")
    assert driver.execute_script("return window.hacked") is None
    assert not driver.find_elements("css selector", "main img, main i, main svg[onload]")
    assert problems(driver) == []


# --- an identification ---


@pytest.fixture(scope="module")
def fitted_page(run_folder, tmp_path_factory) -> Path:
    folder = shutil.copytree(run_folder, tmp_path_factory.mktemp("fitted") / "run")
    joints = World().joints
    return write_report(add_identification(folder, make_fit(joints, "at-bound"), joints))


def sticking_out(driver):
    return driver.execute_script(
        "return [...document.querySelectorAll('main *')].filter((e) => !e.closest('.scroll') && !e.closest('svg')"
        " && e.getBoundingClientRect().right > document.documentElement.clientWidth + 1).map((e) => e.outerHTML.slice(0, 80))"
    )


@pytest.mark.long
def test_a_fit_opens_with_its_status_and_draws_all_figures(driver, fitted_page, tmp_path):
    show(driver, fitted_page)
    alert = driver.find_element("css selector", ".alert.careful")
    assert "On a bound" in alert.text
    lead, tiles = (driver.find_element("css selector", f"#verdict > {own}") for own in (".lead", ".tiles"))
    assert lead.location["y"] < tiles.location["y"] < tiles.location["y"] + tiles.size["height"] < 900
    assert tiles.location["y"] < alert.location["y"]
    assert alert.value_of_css_property("background-color") != "rgba(0, 0, 0, 0)"
    drawn = driver.execute_script(
        "return [...document.querySelectorAll('.figure')].map((e) => [e.dataset.figure || e.id, e.data ? e.data.length : 0,"
        " e.querySelectorAll('.main-svg').length])"
    )
    names = [name for name, *_ in drawn]
    assert len(names) == 7 + 7 + 3
    assert {"kp", "delay_s", "shares", "models", "graybox"} <= set(names)
    assert all(traces and pictures for _, traces, pictures in drawn)
    assert sticking_out(driver) == []
    screenshot(driver, tmp_path / "fitted.png")
    assert problems(driver) == []
    assert all(url.startswith(("file:", "data:", "blob:")) for url in requests(driver))


@pytest.mark.long
def test_intervals_stand_where_the_numbers_say(driver, fitted_page):
    show(driver, fitted_page)
    # horizontal ends of each interval on the screen, by joint
    ends = driver.execute_script(
        "const e = document.querySelector('[data-figure=damping]');"
        "return e.data.filter((t) => t.mode === 'lines').map((t) => t.x.map((x) => x && e._fullLayout.xaxis.l2p(Math.log10(x))))"
    )
    spans = [span for line in ends for span in (line[index : index + 2] for index in range(0, len(line), 3))]
    widths = [high - low for low, high in spans]
    assert widths[0] < widths[1], "what is weakly determined is shorter than what is not determined"
    assert all(0 <= low < high for low, high in spans)
    wait_for(driver, "return document.querySelector('[data-figure=damping] .shapelayer path') !== null")
    one, mark = driver.execute_script(
        "const e = document.querySelector('[data-figure=damping]'), line = e.querySelector('.shapelayer path');"
        "const left = e.getBoundingClientRect().x + e._fullLayout._size.l;"
        "return [e._fullLayout.xaxis.l2p(0), line.getBoundingClientRect().x - left]"
    )
    assert mark == pytest.approx(one, abs=2.0), "the line stands at a factor of one"


@pytest.mark.long
def test_a_share_below_zero_is_drawn_to_the_left_of_zero(driver, fitted_page):
    show(driver, fitted_page)
    spans = driver.execute_script(
        "const e = document.querySelector('[data-figure=shares]');"
        "return Object.fromEntries(e.calcdata.map((bars, i) => [e.data[i].name, bars.map((b) => [b.s0, b.s1])]))"
    )
    low, high = sorted(spans["gravity or payload"][2])
    assert (low, high) == (pytest.approx(-13.75, rel=1e-3), 0)
    # what is to the right of zero reaches beyond 100 % by as much
    assert max(end for bars in spans.values() for end in bars[2]) == pytest.approx(113.75, rel=1e-3)
    assert max(end for bars in spans.values() for end in bars[1]) == pytest.approx(100.0, rel=1e-3)


@pytest.mark.long
def test_menus_of_models_and_of_the_gray_box(driver, fitted_page):
    from selenium.webdriver.support.ui import Select

    show(driver, fitted_page)

    def text(section, slot):
        return driver.execute_script(f"return document.querySelector('#{section} [data-table={slot}]').innerText")

    overview, joints = text("left", "models"), text("left", "model-joints")
    Select(driver.find_element("css selector", "#left select")).select_by_value("train")
    assert text("left", "models") == overview
    assert text("left", "model-joints") != joints
    before = text("graybox", "graybox")
    joint, split = driver.find_elements("css selector", "#graybox select")
    Select(split).select_by_value("train")
    assert text("graybox", "graybox") != before
    Select(joint).select_by_value("gripper")
    assert "left out: the joint never moved" in text("graybox", "graybox")
    assert problems(driver) == []


@pytest.mark.long
@pytest.mark.parametrize("dark", [False, True])
def test_a_fit_fits_a_phone(driver, fitted_page, tmp_path, dark):
    features = [{"name": "prefers-color-scheme", "value": "dark" if dark else "light"}]
    driver.execute_cdp_cmd("Emulation.setEmulatedMedia", {"features": features})
    try:
        show(driver, fitted_page, 390, mobile=True)
        wide, narrow = driver.execute_script(
            "const e = document.documentElement; return [e.scrollWidth, e.clientWidth]"
        )
        assert (narrow, wide <= narrow) == (390, True)
        assert sticking_out(driver) == []
        # each parameter is a card that needs no scrolling to the side
        scrolls = driver.execute_script(
            "return [...document.querySelectorAll('#parameters .scroll')].filter((e) => e.scrollWidth > e.clientWidth + 1).length"
        )
        assert scrolls == 0
        screenshot(driver, tmp_path / "phone.png")
    finally:
        driver.execute_cdp_cmd("Emulation.setEmulatedMedia", {"features": []})


@pytest.mark.long
def test_117_parameters_unfold_on_a_click_and_on_paper(driver, run_folder, tmp_path):
    folder = shutil.copytree(run_folder, tmp_path / "run")
    joints = [f"joint_{number:02}" for number in range(29)]
    page = write_report(add_identification(folder, make_fit(joints, "not-identifiable", many_parameters()), joints))
    show(driver, page)
    row = driver.find_element("css selector", "#parameters tr.row-no")
    assert not row.is_displayed()
    driver.find_element("css selector", "#parameters summary").click()
    assert row.is_displayed()
    driver.execute_script("window.dispatchEvent(new Event('beforeprint'))")
    assert all(driver.execute_script("return [...document.querySelectorAll('#parameters details')].map((e) => e.open)"))
    assert problems(driver) == []


@pytest.mark.long
def test_hostile_names_of_a_fit_are_only_text(driver, tmp_path):
    joints = ("</script><script>window.hacked=1</script>", "<img src=x onerror='window.hacked=2'>", "__proto__")
    folder = make_run(tmp_path / "run", World(joints=joints, scored=joints[:2], samples=120))
    parameters = fit_parameters(joints, "not-identifiable")
    page = write_report(add_identification(folder, make_fit(joints, "not-identifiable", parameters), joints))
    show(driver, page)
    assert driver.execute_script("return window.hacked") is None
    assert not driver.find_elements("css selector", "main img")
    heads = driver.execute_script(
        "return [...document.querySelectorAll('#parameters tbody th')].map((e) => e.textContent)"
    )
    assert set(joints) == set(heads)
    assert problems(driver) == []


@pytest.mark.long
def test_learned_corrections_are_drawn_and_follow_their_menus(driver, run_folder, tmp_path):
    from selenium.webdriver.support.ui import Select

    folder = shutil.copytree(run_folder, tmp_path / "run")
    evaluation(simulate(World())).save(folder / "augment.json")
    page = write_report(folder)
    show(driver, page)
    drawn = "return [...document.querySelectorAll('#augmentation .figure')].map((e) => e.data ? e.data.length : 0)"
    assert all(driver.execute_script(drawn))
    table = "return document.querySelector('#augmentation [data-table=cuts]').innerText"
    before = driver.execute_script(table)
    Select(driver.find_element("css selector", "#cuts-chooser select")).select_by_value("cartesian")
    assert driver.execute_script(table) != before
    motion = driver.find_elements("css selector", "#motion-chooser select")[0]
    panels = "return document.querySelectorAll('#motion-chooser .scatterlayer').length"
    assert driver.execute_script(panels) == 3
    Select(motion).select_by_value("cartesian")
    assert driver.execute_script(panels) == 3
    assert problems(driver) == []
    show(driver, page, 390, mobile=True)
    wide, narrow = driver.execute_script("const e = document.documentElement; return [e.scrollWidth, e.clientWidth]")
    assert wide <= narrow == 390


# --- a close ---


@pytest.fixture(scope="module")
def closed_page(tmp_path_factory) -> Path:
    folder = make_close(tmp_path_factory.mktemp("closed") / "run")
    evaluation(simulate(World(samples=600))).save(folder / "augment.json")
    return write_report(folder)


def themed(driver, theme):
    driver.execute_cdp_cmd(
        "Emulation.setEmulatedMedia", {"features": [{"name": "prefers-color-scheme", "value": theme}]}
    )


@pytest.mark.long
@pytest.mark.parametrize("theme", ["light", "dark"])
@pytest.mark.parametrize("width", [1280, 390])
def test_a_close_fits_desktop_and_phone(driver, closed_page, tmp_path, width, theme):
    themed(driver, theme)
    try:
        show(driver, closed_page, width, mobile=width < 640)
        wide, narrow = driver.execute_script(
            "const e = document.documentElement; return [e.scrollWidth, e.clientWidth]"
        )
        assert wide <= narrow <= width
        assert sticking_out(driver) == []
        anchors = driver.execute_script("return [...document.querySelectorAll('section')].map((e) => e.id)")
        reading = ["verdict", "ladder", "attribution", "parameters", "augmentation", "traces", "open", "usage"]
        assert [name for name in anchors if name in reading] == reading == anchors[: len(reading)]
        drawn = driver.execute_script(
            "return [...document.querySelectorAll('.figure')].map((e) => [e.dataset.figure || e.id, e.data ? e.data.length : 0])"
        )
        assert all(traces for _, traces in drawn), drawn
        rungs = driver.execute_script("return document.querySelectorAll('[data-table=ladder] tbody tr').length")
        assert rungs == 1 + len(CLOSE_RUNS)
        screenshot(driver, tmp_path / "close.png")
        assert problems(driver) == []
        assert all(url.startswith(("file:", "data:", "blob:")) for url in requests(driver))
    finally:
        driver.execute_cdp_cmd("Emulation.setEmulatedMedia", {"features": []})


@pytest.mark.long
def test_of_many_runs_before_and_after_are_drawn_first(driver, closed_page):
    show(driver, closed_page)
    best = CLOSE_RUNS[-1]
    drawn = [name for name, axis, *_ in curves(driver) if axis == "y"]
    assert drawn == ["measured", "command", CLOSE_RUNS[0], best]
    driver.find_element("css selector", "#trace-runs input[value='mujoco/fitted']").click()
    assert "mujoco/fitted" in [name for name, *_ in curves(driver)]


def focused(driver, script="e.outerHTML.slice(0, 120)"):
    return driver.execute_script(f"const e = document.activeElement; return {script}")


def press(driver, *keys):
    from selenium.webdriver.common.action_chains import ActionChains

    ActionChains(driver).send_keys(*keys).perform()


@pytest.mark.long
@pytest.mark.parametrize("width", [1280, 390])
def test_the_keyboard_reaches_what_scrolls_and_what_is_copied(driver, closed_page, width):
    from selenium.webdriver.common.keys import Keys

    show(driver, closed_page, width, mobile=width < 640)
    driver.execute_script("document.querySelectorAll('details').forEach((e) => { e.open = true; })")
    regions = "[...document.querySelectorAll('.scroll, .copy pre')].filter((e) => e.offsetParent)"
    wait_for(
        driver,
        f"return {regions}.every((e) => (e.tabIndex === 0) === (e.scrollWidth > e.clientWidth + 1"
        " || e.scrollHeight > e.clientHeight + 1))",
    )
    unnamed = driver.execute_script(
        f"return {regions}.filter((e) => e.getAttribute('role') !== 'region' || !e.getAttribute('aria-label')).length"
    )
    assert unnamed == 0
    names = driver.execute_script(f"return {regions}.map((e) => e.getAttribute('aria-label'))")
    assert {"Table: ladder", "Lines: In Isaac Lab"} <= set(names)
    # From the section's heading on, the tab key comes to each button and to the lines that are too long.
    driver.execute_script(
        "const h = document.querySelector('#usage h2'); h.tabIndex = -1; h.focus({ preventScroll: true })"
    )
    buttons = driver.find_elements("css selector", "#usage .copy-button")
    wanted = [button.get_attribute("aria-label") for button in buttons]
    reached = []
    for _ in range(3 * len(buttons)):
        press(driver, Keys.TAB)
        if not focused(driver, "e.closest('#usage') !== null"):
            break
        reached.append(focused(driver, "e.getAttribute('aria-label')"))
    assert [name for name in reached if name in wanted] == wanted
    if width == 390:
        assert "Lines: In Isaac Lab" in reached
        # Which the arrow keys then scroll.
        lines = driver.find_element("css selector", "pre[aria-label='Lines: In Isaac Lab']")
        driver.execute_script("arguments[0].focus()", lines)
        press(driver, Keys.ARROW_RIGHT, Keys.ARROW_RIGHT)
        wait_for(driver, "return document.activeElement.scrollLeft > 0")


@pytest.mark.long
def test_enter_copies_the_lines_or_selects_them(driver, closed_page):
    from selenium.webdriver.common.keys import Keys

    show(driver, closed_page)
    permission = {"permissions": ["clipboardReadWrite", "clipboardSanitizedWrite"]}
    driver.execute_cdp_cmd("Browser.grantPermissions", permission)
    for button in driver.find_elements("css selector", ".copy-button")[:2]:
        block = button.find_element("xpath", "..")
        lines = block.find_element("css selector", "pre").get_property("textContent")
        driver.execute_script("arguments[0].focus()", button)
        press(driver, Keys.ENTER)
        said = block.find_element("css selector", ".copied")
        wait_for(driver, "return [...document.querySelectorAll('.copied')].some((e) => e.textContent)")
        assert said.text == "Copied."
        assert driver.execute_async_script("navigator.clipboard.readText().then(arguments[0])") == lines
        driver.execute_script("arguments[0].textContent = ''", said)
    # Without a clipboard the lines are selected, for the keys of the system.
    driver.execute_script(
        "Object.defineProperty(navigator, 'clipboard', { value: undefined, configurable: true });"
        "document.execCommand = () => false"
    )
    press(driver, Keys.ENTER)
    wait_for(driver, "return [...document.querySelectorAll('.copied')].some((e) => e.textContent)")
    assert said.text.startswith("Selected: copy with")
    assert driver.execute_script("return window.getSelection().toString()").strip() == lines.strip()
    assert problems(driver) == []


@pytest.mark.long
def test_lines_are_there_without_an_identification(driver, tmp_path):
    """A close that ended before it: networks for the model as it came."""
    folder = make_close(tmp_path / "run")
    for name in ("fit.json", "explain.json", "robot.fitted.yaml", "model.fitted.xml"):
        (folder / name).unlink()
    show(driver, write_report(folder))
    block = driver.find_element("css selector", "#usage .copy pre")
    assert block.value_of_css_property("user-select") == "all"
    assert driver.find_element("css selector", "#usage .copy-button").is_displayed()
