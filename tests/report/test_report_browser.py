"""The diagnosis report in a browser: it works offline, its cursor moves, a phone shows it all."""

import json

import pytest
from tests.chromium import NAMES, Page, installed, opened
from tests.report.test_command_pages import SOURCE, designs, run
from tests.report.test_report import page_of

from diffsea.recordings import Finding
from diffsea.report.pages.recordings import audit_page, segments_page
from diffsea.report.pages.sensitivity import sensitivity_page
from diffsea.report.pages.sweep import sweep_page
from diffsea.segments.segments import segments_of
from diffsea.segments.signals import signals_of


pytestmark = [
    pytest.mark.slow,
    pytest.mark.skipif(
        installed() is None, reason=f"no browser is on the path (looked for {', '.join(NAMES)})"
    ),
]


@pytest.fixture(scope="module")
def page(tmp_path_factory):
    """The report of an ambiguous case at desktop width; tests leave it as they found it."""
    folder = tmp_path_factory.mktemp("browser")
    file = folder / "report.html"
    file.write_text(page_of("ambiguous"), encoding="utf-8")
    with opened(file, folder / "profile") as shown:
        yield shown


def hover(page: Page, plot: str, across: float, down: float) -> None:
    """The mouse at a share of a plot's inner area."""
    page.run(f"{plot}.scrollIntoView({{block: 'center'}})")
    box = page.run(
        f"(b => [b.x, b.y, b.width, b.height])({plot}.querySelector('.nsewdrag')"
        ".getBoundingClientRect())"
    )
    # Plotly notices a move, not a mouse that was always there.
    for step in (0.02, 0.0):
        page.mouse(box[0] + (across + step) * box[2], box[1] + down * box[3])


def plot(section: str, number: int) -> str:
    return f"document.querySelectorAll('#{section} .plot')[{number}]"


def test_every_plot_is_drawn_without_complaint_or_request(page):
    drawn = page.run("[...document.querySelectorAll('.plot')].map(p => !!p.querySelector('svg'))")
    assert len(drawn) == 12 and all(drawn)
    assert page.complaints == []
    assert page.requests and all(u.startswith(("file:", "data:", "blob:")) for u in page.requests)
    # Should anything try, the page's own policy stops it, not the lack of a network.
    told = page.run(
        "new Promise(done => { document.addEventListener('securitypolicyviolation', "
        "() => done('forbidden'), {once: true}); fetch('https://example.org')"
        ".catch(() => setTimeout(() => done('failed'), 500)); })"
    )
    assert told == "forbidden"
    page.complaints.clear()


def test_hovering_moves_the_cursor_in_all_plots_of_the_run(page):
    track, times, other = plot("verdict", 0), plot("held-out", 0), plot("held-out", 2)
    line = f"{times}.layout.shapes[0]"
    assert page.run(f"{line}.visible") is False
    for share in (0.25, 0.75):
        hover(page, times, share, 0.5)
        # Nearer than the first of the mouse's two moves, so that none is under way any more.
        page.until(f"{line}.visible && Math.abs({line}.x0 - {share} * 69.5) < 0.7")
        # The marks on the tracks are where each track is at that time.
        for k in range(3):
            mark, curve = f"{track}.layout.shapes[{k}]", f"{track}.data[{k}]"
            row = f"{curve}.customdata.findIndex(t => Math.abs(t - {line}.x0) <= 0.26)"
            assert page.run(f"{mark}.visible")
            here = page.run(f"[{mark}.xanchor, {mark}.yanchor, {curve}.x[{row}], {curve}.y[{row}]]")
            assert here[:2] == pytest.approx(here[2:], abs=0.8)
    assert page.run(f"{other}.layout.shapes[0].visible") is False
    assert page.complaints == []


def test_the_slider_of_time_moves_the_cursor_and_follows_it(page):
    track, times = plot("verdict", 0), plot("held-out", 0)
    slider = f"{track}.parentElement.querySelector('.time input')"
    # Plotly tells of a hover up to 50 ms late: one of the test before would move the cursor back.
    page.mouse(0, 0)
    assert page.run(f"[+{slider}.min, +{slider}.max]") == pytest.approx([0.0, 69.5], abs=0.5)
    page.run(f"{slider}.value = 20; {slider}.dispatchEvent(new Event('input'))")
    page.until(f"Math.abs({times}.layout.shapes[0].x0 - 20) < 0.2")
    assert page.run(f"{slider}.nextElementSibling.textContent") == "20.0 s"
    hover(page, times, 0.5, 0.5)
    page.until(f"Math.abs(+{slider}.value - 0.5 * 69.5) < 3")
    assert page.complaints == []


def test_plots_follow_the_readers_colours_and_paper_is_light(page):
    def colours() -> list[str]:
        drawn = f"{plot('held-out', 1)}._fullLayout"
        body = "getComputedStyle(document.body).backgroundColor"
        return page.run(f"[{drawn}.paper_bgcolor, {drawn}.font.color, {body}]")

    light = colours()
    assert light[0] in ("#fff", "rgb(255, 255, 255)")
    page.prefer("dark")
    page.until(f"{plot('held-out', 1)}._fullLayout.paper_bgcolor === 'rgba(0,0,0,0)'")
    dark = colours()
    assert dark[1] != light[1] and dark[2] != light[2]
    page.run("dispatchEvent(new Event('beforeprint'))")
    page.until(f"{plot('held-out', 1)}._fullLayout.paper_bgcolor === '{light[0]}'")
    page.run("dispatchEvent(new Event('afterprint'))")
    page.until(f"{plot('held-out', 1)}._fullLayout.paper_bgcolor === 'rgba(0,0,0,0)'")
    page.send("Emulation.setEmulatedMedia", features=[])
    page.until(f"{plot('held-out', 1)}._fullLayout.paper_bgcolor === '{light[0]}'")
    assert colours() == light and page.complaints == []


def test_hovering_a_map_moves_the_mark_on_its_track(page):
    heat, track = plot("where", 2), plot("where", 3)
    hover(page, heat, 0.5, 0.5)
    page.until(f"{track}.layout.shapes[0].visible")
    time = page.run(f"{heat}.layout.shapes[0].x0")
    assert time == pytest.approx(0.5 * 69.6, abs=3.0)


def test_a_legend_entry_hides_its_curves_in_all_plots_of_the_run(page):
    track, times = plot("verdict", 0), plot("held-out", 0)
    shown = (
        f"[...{track}.data, ...{times}.data].filter(t => t.name === 'nominal')"
        ".map(t => t.visible ?? true)"
    )
    entry = f"{track}.querySelectorAll('.legendtoggle')[1]"
    assert page.run(shown) == [True] * 6
    for wanted in ("legendonly", True):
        page.run(f"{track}.scrollIntoView({{block: 'center'}})")
        at = page.run(
            f"(b => [b.x + b.width / 2, b.y + b.height / 2])({entry}.getBoundingClientRect())"
        )
        page.mouse(*at, click=True)
        page.until(f"{shown}.every(v => v === {'true' if wanted is True else repr(wanted)})")
    others = f"[...{track}.data, ...{times}.data].map(t => t.visible ?? true)"
    assert page.run(f"{others}.every(v => v === true)")


def test_keys_press_a_legend_entry_and_zoom_a_plot(page):
    track, times = plot("verdict", 0), plot("held-out", 0)
    entry = f"{track}.querySelectorAll('.legendtoggle')[1]"
    name = page.run(f"{entry}.getAttribute('aria-label')")
    shown = f"{times}.data.filter(t => t.name === '{name}').map(t => t.visible ?? true)"
    page.run(f"{entry}.focus()")
    for key, wanted in (("Enter", "legendonly"), (" ", True)):
        page.press(key)
        page.until(f"{shown}.every(v => v === {json.dumps(wanted)})")
        focused = "document.activeElement.getAttribute('aria-label')"
        page.until(f"{focused} === '{name}'")
        checked = page.run("document.activeElement.getAttribute('aria-checked')")
        assert checked == ("true" if wanted is True else "false")
    spans = f"{times}._fullLayout.xaxis.range"
    low, high = page.run(spans)
    page.run(f"{times}.focus()")
    for key, ends in {
        "+": (0.15, 0.85),
        "ArrowRight": (0.22, 0.92),
        "-": (0.07, 1.07),
        "0": (0.0, 1.0),
    }.items():
        page.press(key)
        expected = [low + end * (high - low) for end in ends]
        near = f"Math.abs({spans}[0] - {expected[0]}) + Math.abs({spans}[1] - {expected[1]})"
        page.until(f"{near} < 0.01")
    assert page.complaints == []


def test_the_first_key_leads_past_the_contents(page):
    page.run("document.activeElement.blur(); scrollTo(0, 0)")
    assert page.run("document.querySelector('a, button, input').className") == "skip"
    page.run("document.querySelector('.skip').focus()")
    assert page.run("document.querySelector('.skip').getBoundingClientRect().left") >= 0
    page.press("Enter")
    page.until("location.hash === '#content' && document.activeElement.id === 'content'")


def test_tracks_take_the_chosen_colour(page):
    chosen = "document.querySelector('select.colouring')"
    seen = (
        "[...document.querySelectorAll('.coloured .plot')].map(p => p.data"
        ".filter(t => t.meta && t.meta.colouring && t.visible).map(t => t.meta.colouring).join())"
    )
    first, last = page.run(f"[{chosen}.options[0].value, {chosen}.options[5].value]")
    for value in (last, first):
        page.run(f"{chosen}.value = '{value}'; {chosen}.dispatchEvent(new Event('change'))")
        page.until(f"{seen}.every(name => name === '{value}')")
    assert first == "N (yaw), nominal model" and first != last


@pytest.mark.parametrize(("width", "phone"), [(1280, False), (390, True)])
def test_nothing_is_wider_than_the_window(page, width, phone):
    page.resize(width, 900, phone)
    page.until("[...document.querySelectorAll('.plot')].every(p => Math.abs("
               "p.clientWidth - p.querySelector('svg').clientWidth) < 2)")  # fmt: skip
    over = page.run("document.documentElement.scrollWidth - document.documentElement.clientWidth")
    assert over <= 0
    # Curves are clipped at the edge of their plot; words and boxes must not reach beyond it.
    wide = page.run(
        "[...document.querySelectorAll('main *')].filter(e => (e instanceof HTMLElement ||"
        " e.tagName === 'text') && e.getBoundingClientRect().width > 0 && (b => b.left < -1 &&"
        " b.left > -2000 || b.right > document.documentElement.clientWidth + 1)"
        "(e.getBoundingClientRect())).map(e => e.tagName + ' ' + e.textContent.slice(0, 40))"
    )
    assert wide == []
    smallest = page.run(
        "Math.min(...[...document.querySelectorAll('.plot')].map(p => p.clientWidth))"
    )
    assert smallest > 0.75 * width if phone else smallest > 400


def test_a_fold_draws_its_plots_when_it_opens(page):
    page.resize(1280, 900)
    page.run("document.querySelectorAll('details').forEach(d => d.open = true)")
    page.until("[...document.querySelectorAll('.plot')].every(p => p.dataset.drawn)")
    assert page.complaints == []


def _segments() -> str:
    circle = run("circle.csv")
    return segments_page([(circle, segments_of(signals_of(circle, None)), [])], SOURCE)


PAGES = {
    "audit": lambda: audit_page(
        [("run.csv", [Finding("gyro-bias", 0.02, 0.001, "rad/s", "off", "subtract it", ("r",))])],
        {"run.csv": run("run.csv")},
        [],
        SOURCE,
    ),
    "segment": _segments,
    "map": lambda: sweep_page(*designs(3, 4), SOURCE),
    "line": lambda: sweep_page(*designs(5), SOURCE),
    "sensitivity": lambda: sensitivity_page(
        {"overshoot_1": {"mass": 0.4, "N_r": -1.5}}, {"overshoot_1": 0.1}, ("b", "zigzag"), SOURCE
    ),
}


@pytest.mark.parametrize("scheme", ["light", "dark"])
@pytest.mark.parametrize(("width", "phone"), [(1280, False), (400, True)])
def test_pages_of_other_commands_are_whole_at_every_width_and_in_all_colours(
    page, tmp_path, width, phone, scheme
):
    page.resize(width, 900, phone)
    page.prefer(scheme)
    for name, make in PAGES.items():
        file = tmp_path / f"{name}.html"
        file.write_text(make(), encoding="utf-8")
        page.show(file)
        drawn = page.run(
            "[...document.querySelectorAll('.plot')].map(p => !!p.querySelector('svg'))"
        )
        assert drawn and all(drawn), name
        ground = page.run("document.querySelector('.plot')._fullLayout.paper_bgcolor")
        assert (ground == "rgba(0,0,0,0)") == (scheme == "dark"), name
        over = page.run(
            "document.documentElement.scrollWidth - document.documentElement.clientWidth"
        )
        assert over <= 0, name
        page.run("document.querySelector('.plot').focus()")
        page.press("+")
        if page.run("!!document.querySelector('.legendtoggle')"):
            page.run("document.querySelector('.legendtoggle').focus()")
            page.press("Enter")
            page.until(
                "document.querySelector('.legendtoggle').getAttribute('aria-checked') === 'false'"
            )
        assert page.complaints == [], name


def test_the_key_of_shaded_segments_hides_and_shows_them(page, tmp_path):
    page.resize(1280, 900)
    page.prefer("light")
    file = tmp_path / "segments.html"
    file.write_text(_segments(), encoding="utf-8")
    page.show(file)
    drawn = "document.querySelectorAll('.plot')[1]"
    shaded = f"{drawn}.layout.shapes.filter(s => s.name === 'turning').map(s => s.visible ?? true)"
    entry = f"{drawn}.querySelectorAll('.legendtoggle')[1]"
    assert page.run(f"{entry}.getAttribute('aria-label')") == "turning"
    page.run(f"{entry}.scrollIntoView({{block: 'center'}})")
    at = page.run(
        f"(b => [b.x + b.width / 2, b.y + b.height / 2])({entry}.getBoundingClientRect())"
    )
    page.mouse(*at, click=True)
    page.until(f"{shaded}.length && {shaded}.every(v => v === 'legendonly')")
    page.until(f"{entry}.getAttribute('aria-checked') === 'false'")
    page.run(f"{entry}.focus()")
    page.press(" ")
    page.until(f"{shaded}.every(v => v === true)")
    assert page.complaints == []
