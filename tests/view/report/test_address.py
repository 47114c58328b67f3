"""What a run's page gives away: an address that follows what is shown, a link, a picture."""

import time

from PIL import Image

SETTLED = "new Promise(done => setTimeout(() => done(decodeURIComponent(location.hash)), 300))"


def wait_for(path, patience_s=20.0):
    deadline = time.monotonic() + patience_s
    while not path.is_file():
        assert time.monotonic() < deadline, sorted(path.parent.iterdir())
        time.sleep(0.02)
    return path


def test_names_that_are_not_there_are_passed_over(browser, page):
    for hash in ("camera=nowhere&vessel=nobody&layers=ghosts&x=%", "&=&layers=constructor,toString"):
        browser.open(page, hash=f"#vessel=&step=50&{hash}")
        assert browser.run("document.querySelector('#failure').hidden && player.shown.detections")
        assert browser.run("[player.index, player.camera, player.followed]") == [50, 0, None]


def test_the_address_follows_step_camera_vessel_and_layers_and_brings_them_back(browser, page):
    browser.open(page)
    assert browser.run(SETTLED) == ""  # until something is done, and while the run plays
    browser.run("(player.playback.setSpeed(0.25), player.go(5), player.play(true))")
    assert browser.run(SETTLED) == ""
    browser.run("player.play(false)")
    assert browser.run(SETTLED) == browser.run("`#step=${player.index}&camera=C1`")
    browser.run("(player.look(1), player.go(120), player.choose(2))")
    browser.press("8")
    browser.press("1")
    layers = "full,visible,detections,false,missed,labels,names"
    vessel = browser.run("player.recording.facts.vessels[2].name")
    address = f"#step=120&camera=C2&vessel={vessel}&layers={layers}"
    assert browser.run(SETTLED) == address
    browser.open(page, hash=address)
    shown = "Object.keys(player.shown).filter(name => player.shown[name]).join(',')"
    controls = "document.querySelector('#layer-silhouettes').checked, document.querySelector('#camera').value"
    state = f"[player.index, player.camera, player.followed, {shown}, {controls}]"
    assert browser.run(state) == [120, 1, 2, layers, False, "1"]
    browser.run("(location.hash = '#step=50&camera=C1', new Promise(done => setTimeout(done, 50)))")
    usual = "silhouettes,full,visible,detections,false,missed,labels"
    # What a link leaves out is as usual, also in an open page.
    assert browser.run(state) == [50, 0, None, usual, True, "0"]


def test_the_link_is_copied_or_offered_in_a_field_and_the_picture_is_saved_with_a_caption(browser, page, tmp_path):
    browser.call("Browser.grantPermissions", permissions=["clipboardReadWrite", "clipboardSanitizedWrite"])
    browser.call("Browser.setDownloadBehavior", behavior="allow", downloadPath=str(tmp_path))
    browser.open(page, hash="#step=40")
    browser.press("ArrowRight")
    browser.click("[data-do=link]")
    said = "new Promise(done => setTimeout(() => done(document.querySelector('#note').textContent), 50))"
    assert browser.run(said) == "Link copied"
    assert browser.run("navigator.clipboard.readText()") == page.resolve().as_uri() + "#step=41&camera=C1"
    browser.run("(Object.defineProperty(navigator, 'clipboard', { value: undefined }), player.actions.link())")
    field = "(field => [field.value, field.selectionEnd - field.selectionStart])(document.activeElement)"
    link = browser.run("location.href")
    assert browser.run(field) == [link, len(link)]
    browser.click("[data-do=save]")
    with Image.open(wait_for(tmp_path / "simulation_3_C1_41.png")) as image:
        saved = image.convert("L")
    wide, high = browser.run("[player.pane.canvas.width, player.pane.canvas.height]")
    assert saved.size == (wide, high + 30)
    assert 100 < sum(saved.crop((0, high, wide, high + 30)).histogram()[:100]) < 0.2 * 30 * wide  # text on paper
