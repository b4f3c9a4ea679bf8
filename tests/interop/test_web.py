"""The folder of `cargo xtask web` in headless Chromium: a group without a server behind it.

What happens in its world is compared with this machine's to the byte. Nothing depends on how fast this machine is;
how fast it was is printed."""

import functools
import http.server
import json
import os
import pathlib
import threading
import unittest

from page import Browser, Tab

FOLDER = pathlib.Path(os.environ["OMNIBUS_WEB"])
NATIVE = pathlib.Path(os.environ["OMNIBUS_WEB_NATIVE"])
CHOICES = {
    "table": dict(group="tcc-3", floor="table", phases=False, robots="native"),
    "contact": dict(group="sizes", floor="contact", phases=True, robots="native"),
    "emulated": dict(group="single", floor="table", phases=False, robots="emulated"),
}
speed = "(state && state.measured ? Math.hypot(state.measured[0], state.measured[1]) : 0)"


class Quiet(http.server.SimpleHTTPRequestHandler):
    def log_message(self, *_):
        pass


class Web(unittest.TestCase):
    @classmethod
    def setUpClass(cls):
        handler = functools.partial(Quiet, directory=FOLDER)
        server = http.server.ThreadingHTTPServer(("127.0.0.1", 0), handler)
        threading.Thread(target=server.serve_forever, daemon=True).start()
        cls.addClassCleanup(server.shutdown)
        cls.url = f"http://127.0.0.1:{server.server_port}/index.html"
        cls.browser = Browser()
        cls.addClassCleanup(cls.browser.close)

    def tab(self, fragment="", url=None, **options):
        tab = Tab(self.browser, (url or self.url) + fragment, **options)
        self.addCleanup(tab.close)
        tab.wait("typeof state !== 'undefined' && state && welcome && world.opened")
        return tab

    def test_a_metre_is_that_of_this_machine_to_the_byte(self):
        tab = self.tab("#robots=emulated&group=single")
        for name, choice in CHOICES.items():
            with self.subTest(name):
                wanted = (NATIVE / f"{name}.json").read_text()
                asked = json.dumps({**choice, "compensation": True})
                tab.run(f"window.outcome = null; scenario({asked}).then((text) => {{ window.outcome = text; }}); 0")
                got = tab.wait("window.outcome")
                wanted_now, got_now = json.loads(wanted), json.loads(got)
                self.assertEqual(got_now["samples"], wanted_now["samples"])
                self.assertEqual(got_now["log"], wanted_now["log"])
                self.assertEqual(got, wanted)
                way = got_now["samples"][-1]["pose"][0]
                frames = got_now["log"].count("\n")
                print(f"{name}: {way:.3f} m, {frames} frames, the same as on this machine")

    def test_the_page_begins_to_drive_by_itself(self):
        tab = self.tab("#robots=native")
        tab.wait(f"{speed} > 0.01")
        print(f"in motion {tab.run('performance.now()') / 1000:.2f} s after opening (native)")
        tab.run("window.count = 0; (function next() { count += 1; requestAnimationFrame(next); })(); window.from = performance.now(); 0")
        tab.wait("performance.now() - from > 3000")
        pictures = tab.run("count / (performance.now() - from) * 1000")
        pace = tab.run("$('pace').textContent")
        print(f"{pictures:.1f} pictures a second; {pace}")
        tab.wait("trail.length > 20 && aims.length > 20")
        tab.picture(FOLDER.parent / "web-check" / "page.png")

    def test_what_the_machine_allows_is_chosen_and_said(self):
        tab = self.tab()
        said = tab.wait("$('world-says').textContent")
        self.assertRegex(said, r"^(Native|Emulated) robots: .* at \d+\.\d times real time")
        tab.wait(f"{speed} > 0.01")
        print(f"in motion {tab.run('performance.now()') / 1000:.2f} s after opening; {said}")

    def test_a_hand_drives(self):
        tab = self.tab("#robots=native&group=tcc-2")
        tab.run("panes.stopPlaying(); if (course) release(); 0")
        tab.run("if (!seat.yours) send({type: 'take'}); 0")
        tab.wait("seat.yours")
        tab.run("if (state.phase === 'idle') $('start').click(); 0")
        tab.wait("ready()")
        tab.wait(f"{speed} < 0.001")
        before = tab.run("here[0]")
        tab.key("keyDown", "ArrowUp", "ArrowUp")
        tab.wait(f"here[0] > {before} + 0.2")
        tab.key("keyUp", "ArrowUp", "ArrowUp")
        tab.wait(f"{speed} < 0.001")
        self.assertEqual(tab.run("state.phase"), "running")

    def test_panes_and_faults(self):
        tab = self.tab("#robots=emulated&group=single")
        tab.run("$('look-frames').click(); 0")
        tab.wait("[...$('frames').children].some((line) => line.textContent.includes('MemberStatus 2: Moving'))")
        tab.wait("$('inside').textContent.includes('pc 0')")
        tab.wait("$('inside').textContent.includes('TIM1 CH1')")
        self.assertTrue(tab.wait("$('inside-log').children.length"))
        tab.run("[...$('faults').children].find((button) => button.textContent === 'Press the emergency stop').click(); 0")
        tab.wait("[...$('log').children].some((line) => line.className === 'error' && line.textContent.includes('EmergencyStop'))")
        tab.wait("state.phase === 'idle'")

    def test_another_world_is_opened(self):
        tab = self.tab("#robots=native&group=single")
        self.assertEqual(tab.run("welcome.robots.length"), 1)
        tab.run("const list = $('choose-group'); list.value = 'tcc-3'; list.dispatchEvent(new Event('change')); 0")
        tab.wait("welcome.robots.length === 3 && state && state.robots.length === 3")
        tab.wait(f"{speed} > 0.01")

    def test_it_works_without_a_server(self):
        tab = self.tab("#robots=emulated&group=single", url=(FOLDER / "index.html").as_uri())
        tab.wait(f"{speed} > 0.01")

    def test_a_document_has_the_live_page(self):
        tab = Tab(self.browser, self.url.replace("index.html", "README.html"))
        self.addCleanup(tab.close)
        tab.wait("document.querySelector('iframe.live') !== null")
        inside = f'typeof state !== "undefined" && {speed} > 0.01'
        tab.wait(f"document.querySelector('iframe.live').contentWindow.eval({json.dumps(inside)})")


if __name__ == "__main__":
    unittest.main()
