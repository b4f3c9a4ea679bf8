"""The page of `omnibus serve` in headless Chromium, and its server without a browser.

Times that matter are those of the simulated bus, which stand in the states; nothing depends on how fast this
machine is."""

import http.client
import json
import math
import os
import pathlib
import signal
import socket
import subprocess
import tempfile
import unittest

import websockets

from page import PATIENCE, Browser, Client, Tab, wait

ROOT = pathlib.Path(__file__).resolve().parents[2]
PICTURES = pathlib.Path(os.environ["OMNIBUS_LOGS"]).parent
STALE = 0.25
"""s; a press without a message for this long is over (docs/recording.md)."""
ON_THE_WAY = 0.15
"""s; two states of 50 ms each to see it, and four SYNC periods on the way."""

speed = "(state && state.measured ? Math.hypot(state.measured[0], state.measured[1]) : 0)"
asked = "(state ? Math.hypot(state.command[0], state.command[1]) + Math.abs(state.command[2]) : 0)"


class Served(unittest.TestCase):
    OPTIONS = []

    def setUp(self):
        command = [os.environ["OMNIBUS"], "serve", "--http", "127.0.0.1:0", "--json", "--bus"]
        command += [f"sim:{ROOT / 'groups' / 'tcc-2.toml'}", *self.OPTIONS]
        self.process = subprocess.Popen(command, stdout=subprocess.PIPE, text=True)
        self.addCleanup(self.end)
        place = json.loads(self.process.stdout.readline())
        self.url, self.token = place["url"], place["token"]
        self.address = self.url.split("/")[2]

    def end(self):
        self.process.send_signal(signal.SIGINT)
        self.process.stdout.close()
        self.assertEqual(self.process.wait(PATIENCE), 0)

    def client(self, token=None, **options):
        client = Client(self.address, token, **options)
        self.addCleanup(client.socket.close)
        client.until("a state", lambda: client.states)
        return client

    def moving(self, client):
        return math.hypot(*client.states[-1]["command"][:2]) > 0


class Server(Served):
    def ask(self, path="/", method="GET", **headers):
        connection = http.client.HTTPConnection(self.address, timeout=PATIENCE)
        connection.request(method, path, headers={name.replace("_", "-"): value for name, value in headers.items()})
        answer = connection.getresponse()
        return answer.status, answer.headers, answer.read()

    def test_the_page_is_served_and_nothing_else(self):
        status, headers, body = self.ask()
        self.assertEqual(status, 200)
        self.assertIn("default-src 'none'", headers["Content-Security-Policy"])
        self.assertNotIn(b"https:", body)
        for path in ["/page.css", "/backend.js", "/page.js"]:
            self.assertEqual(self.ask(path)[0], 200)
        self.assertEqual(self.ask("/etc/passwd")[0], 404)
        self.assertEqual(self.ask(method="POST")[0], 405)

    def test_other_names_and_other_pages_are_turned_away(self):
        self.assertEqual(self.ask(Host="evil.example")[0], 421)
        port = self.address.split(":")[1]
        self.assertEqual(self.ask(Host=f"evil.example:{port}")[0], 421)
        with self.assertRaises(websockets.exceptions.InvalidStatus) as raised:
            Client(self.address, origin="http://evil.example")
        self.assertEqual(raised.exception.response.status_code, 403)
        Client(self.address, origin=f"http://{self.address}").socket.close()

    def test_without_the_token_nothing_moves(self):
        for token in [None, "", "wrong", self.token[:-1], self.token + "0"]:
            client = self.client(token)
            client.say(type="take")
            client.say(type="start")
            client.drive(1, 0.2)
            client.until("refusals", lambda: len(client.refusals) >= 3)
            self.assertFalse(self.moving(client))
            self.assertEqual(client.states[-1]["phase"], "idle")
            client.socket.close()

    def test_bad_messages_are_refused_and_end_the_press(self):
        client = self.client(self.token)
        client.start()
        limit = 2.0
        bad = [
            dict(vx=limit * 1.01),
            dict(vx=1e39),
            dict(omega=1.5),
            dict(clock=0),
            dict(clock=10**15),
            dict(vx="0.1"),
            dict(vx=None),
            dict(more=1),
        ]
        for press, change in enumerate(bad, 1):
            with self.subTest(change):
                client.drive(press, 0.2)
                client.until("motion", lambda: self.moving(client) or client.drive(press, 0.2))
                count = len(client.refusals)
                client.drive(press, 0.2, **change) if "vx" not in change else client.drive(press, **change)
                client.until("a refusal", lambda: len(client.refusals) > count)
                client.until("standstill asked", lambda: not self.moving(client))
                # The press stays over.
                client.drive(press, 0.2)
                client.hear(0.1)
                self.assertFalse(self.moving(client))
        for raw in ["", "{", "[]", "null", '{"type":"drive"}', "x" * 1000]:
            count = len(client.refusals)
            client.socket.send(raw)
            client.until("a refusal", lambda: len(client.refusals) > count)

    def test_a_message_too_long_ends_the_connection_and_the_drive(self):
        driver, viewer = self.client(self.token), self.client()
        driver.start()
        driver.socket.send("x" * 100_000)
        viewer.until("robots off", lambda: viewer.states[-1]["phase"] == "idle")

    def last_asked(self, viewer, since):
        """How long after `since`, on the bus's clock, a velocity was still asked for."""
        return max((s["t"] - since for s in viewer.states if math.hypot(*s["command"]) > 0), default=0.0)

    def test_a_press_that_is_not_repeated_ramps_down(self):
        driver, viewer = self.client(self.token), self.client()
        driver.start()
        for _ in range(10):
            driver.drive(1, 0.3)
            driver.hear(0.05)
        sent = driver.states[-1]["t"]
        viewer.until("standstill", lambda: viewer.states[-1]["t"] > sent + 1.0)
        self.assertLessEqual(self.last_asked(viewer, sent), STALE + ON_THE_WAY)
        self.assertGreater(max(s["measured"][0] for s in viewer.states if s["measured"]), 0.25)
        self.assertLess(abs(viewer.states[-1]["measured"][0]), 1e-3)
        # Still started: it was only the press that ended.
        self.assertEqual(viewer.states[-1]["phase"], "running")

    def test_a_lost_connection_ramps_down_and_switches_off(self):
        driver, viewer = self.client(self.token), self.client()
        driver.start()
        for _ in range(10):
            driver.drive(1, 0.3)
            driver.hear(0.05)
        sent = driver.states[-1]["t"]
        # Without a goodbye of the WebSocket.
        driver.socket.socket.shutdown(socket.SHUT_RDWR)
        viewer.until("robots off", lambda: viewer.states[-1]["phase"] == "idle")
        self.assertLessEqual(self.last_asked(viewer, sent), STALE + ON_THE_WAY)

    def test_one_drives_at_a_time_and_anybody_stops(self):
        first, second = self.client(self.token), self.client(self.token)
        first.start()
        second.say(type="take")
        second.until("a refusal", lambda: second.refusals)
        self.assertEqual(second.refusals, ["another client drives"])
        second.drive(1, 0.2)
        second.hear(0.1)
        self.assertFalse(self.moving(second))
        second.say(type="stop")
        second.until("robots off", lambda: second.states[-1]["phase"] == "idle")
        first.say(type="leave")
        second.until("a free seat", lambda: not second.seat["taken"])
        second.start()


    def curve(self, client, press, curve="circle", scale=0.2, **more):
        message = {"clock": client.states[-1]["clock"], **more}
        client.say(type="curve", press=press, curve=curve, scale=scale, **message)

    def test_a_curve_is_refused_before_the_group_is_ready_or_by_what_it_needs(self):
        client, other = self.client(self.token), self.client(self.token)
        refusals = ["take control first", "start the robots first"]
        self.curve(client, 1)
        client.until("a refusal", lambda: len(client.refusals) == 1)
        client.say(type="take")
        self.curve(client, 2)
        client.until("a refusal", lambda: len(client.refusals) == 2)
        self.assertEqual(client.refusals, refusals)
        client.start()
        self.curve(other, 1)
        other.until("a refusal", lambda: other.refusals == ["take control first"])
        for press, change in enumerate([dict(curve="square"), dict(scale=0), dict(scale=2, curve="figure-eight")], 3):
            self.curve(client, press, **change)
            client.until("a refusal", lambda: len(client.refusals) == press)
        self.assertIn("limits.linear_speed is 2 m/s", client.refusals[-1])
        self.assertFalse(any(math.hypot(*s["command"]) for s in client.states))

    def test_a_curve_that_is_not_repeated_ramps_down_and_anybody_stops_one(self):
        driver, viewer = self.client(self.token), self.client()
        driver.start()
        for press in [1, 2]:
            driver.until("the curve", lambda: self.curve(driver, press) or driver.states[-1]["curve"])
            driver.until("motion", lambda: self.curve(driver, press) or self.moving(driver))
            if press == 1:
                sent = driver.states[-1]["t"]
                viewer.until("standstill", lambda: viewer.states[-1]["t"] > sent + 1.0)
                self.assertLessEqual(self.last_asked(viewer, sent), STALE + ON_THE_WAY)
                self.assertIsNone(viewer.states[-1]["curve"])
                # It does not come back.
                self.curve(driver, press)
                driver.hear(0.2)
                self.assertFalse(self.moving(driver))
        viewer.say(type="stop")
        viewer.until("robots off", lambda: viewer.states[-1]["phase"] == "idle")


class Watching(Served):
    OPTIONS = ["--watch"]

    def test_who_only_watches_sends_nothing(self):
        client = self.client(self.token)
        client.say(type="take")
        client.say(type="start")
        client.until("refusals", lambda: len(client.refusals) == 2)
        self.assertEqual(client.states[-1]["phase"], "idle")


class Page(Served):
    @classmethod
    def setUpClass(cls):
        cls.browser = Browser()
        cls.addClassCleanup(cls.browser.close)

    def tab(self, token=None, **options):
        fragment = f"#token={token}" if token is not None else ""
        tab = Tab(self.browser, self.url + fragment, **options)
        self.addCleanup(tab.close)
        tab.wait("typeof state !== 'undefined' && state && welcome && state.robots.length === 2")
        return tab

    def started(self, **options):
        tab = self.tab(self.token, **options)
        tab.wait("trusted")
        tab.click("take")
        tab.wait("seat.yours")
        tab.click("start")
        tab.wait("state && state.phase === 'running'")
        return tab

    def fits(self, tab):
        """Nothing is wider than the window; no two things that are to be read or touched lie on each other."""
        self.assertLessEqual(tab.run("document.documentElement.scrollWidth"), tab.run("window.innerWidth"))
        overlaps = tab.run("""(() => {
            const shown = [...document.querySelectorAll('button, input, .pad, .gauge, .robot, canvas, h1, h2, .badge, #place, label')]
                .filter((e) => e.offsetParent && e.getBoundingClientRect().width > 0 && !e.closest('header'));
            const over = [];
            for (const a of shown) for (const b of shown) {
                if (a === b || a.contains(b) || b.contains(a)) continue;
                const [p, q] = [a.getBoundingClientRect(), b.getBoundingClientRect()];
                if (p.left < q.right - 1 && q.left < p.right - 1 && p.top < q.bottom - 1 && q.top < p.bottom - 1) over.push(`${a.id || a.className} ${b.id || b.className}`);
            }
            return over;
        })()""")
        self.assertEqual(overlaps, [])

    def test_a_viewer_sees_the_group_and_a_wrong_token_does_not_drive(self):
        tab = self.tab("wrong")
        tab.wait("document.getElementById('message').textContent === 'wrong token'")
        self.assertIn("tcc-2", tab.run("document.title"))
        self.assertEqual(tab.run("document.getElementById('phase').textContent"), "idle")
        self.assertTrue(tab.run("document.getElementById('controls').hidden"))
        self.assertFalse(tab.run("location.href").endswith("wrong"))
        # The token may be typed as well.
        tab.run(f"document.getElementById('token').value = '{self.token}'")
        tab.run("document.getElementById('token-form').requestSubmit()")
        tab.wait("trusted && !document.getElementById('controls').hidden")

    def test_the_stick_moves_the_group_and_the_map_while_it_is_held(self):
        tab = self.started()
        before = tab.run("document.getElementById('map').toDataURL()")
        x, y, width = tab.middle("move")
        tab.mouse("mousePressed", x, y)
        tab.mouse("mouseMoved", x, y - width)
        # Up is forward; a quarter of 2 m/s.
        tab.wait("state.command[0] > 0.45 && Math.abs(state.command[1]) < 0.02")
        tab.wait("state.pose && state.pose[0] > 0.5 && trail.length > 10")
        self.assertGreater(tab.run("state.target[0]"), 0.4)
        self.fits(tab)
        tab.picture(PICTURES / "page-1280.png")
        tab.mouse("mouseReleased", x, y - width)
        tab.wait(f"{asked} === 0 && {speed} < 1e-3")
        self.assertNotEqual(tab.run("document.getElementById('map').toDataURL()"), before)
        # The stick of the turn.
        x, y, width = tab.middle("turn")
        tab.mouse("mousePressed", x, y)
        tab.mouse("mouseMoved", x - width, y)
        tab.wait("state.measured && state.measured[2] > 0.2")
        tab.mouse("mouseReleased", x - width, y)
        tab.wait(f"{asked} === 0")

    def test_keys_drive_while_they_are_held(self):
        tab = self.started()
        tab.key("keyDown", "ArrowLeft", "ArrowLeft")
        tab.wait(f"state.command[1] > 0.4 && {speed} > 0.1")
        tab.key("keyUp", "ArrowLeft", "ArrowLeft")
        tab.wait(f"{asked} === 0")
        tab.key("keyDown", "i", "KeyI")
        tab.wait("state.command[0] > 0.4")
        tab.key("keyDown", " ", "Space")
        tab.wait("state.phase === 'idle'")

    def choose(self, tab, curve, scale):
        tab.run(f"document.getElementById('curve').value = '{curve}'; document.getElementById('scale').value = '{scale}'")
        tab.click("begin")

    def test_curves_start_from_the_page_and_end_where_they_say(self):
        tab = self.started()
        said = "document.getElementById('message').textContent"
        names = tab.run("[...document.getElementById('curve').options].map((one) => one.value)")
        self.assertIn("figure-eight", names)
        self.choose(tab, "figure-eight", 3)
        tab.wait(f"{said}.includes('choose a smaller scale')")
        self.assertEqual(tab.run(asked), 0)
        # The whole curve is 8 s at 0.5 m/s; ramps make it take longer, not go farther.
        before = tab.run("state.pose ? state.pose[1] : 0")
        self.choose(tab, "lateral", 0.1)
        tab.wait("state.curve && state.command[1] > 0.04")
        self.fits(tab)
        tab.wait(f"{said}.includes('lateral: 3 of')")
        tab.picture(PICTURES / "page-curve.png")
        tab.wait(f"{said} === 'lateral: done' && {speed} < 1e-3")
        way = tab.run("state.pose[1]") - before
        self.assertAlmostEqual(way, 0.1 * 0.5 * 8, delta=0.01)
        self.assertEqual(tab.run("state.phase"), "running")

    def test_whatever_the_hand_does_ends_a_curve(self):
        tab = self.started()
        said = "document.getElementById('message').textContent"
        x, y, _ = tab.middle("move")
        for end in [
            lambda: tab.click("begin"),
            lambda: tab.key("keyDown", "i", "KeyI") or tab.key("keyUp", "i", "KeyI"),
            lambda: tab.mouse("mousePressed", x, y) or tab.mouse("mouseReleased", x, y),
            lambda: tab.run("window.dispatchEvent(new Event('blur'))"),
        ]:
            self.choose(tab, "circle", 0.5)
            tab.wait(f"state.curve && {asked} > 0.05")
            end()
            tab.wait(f"{said}.startsWith('circle: ended after') && !state.curve && {asked} === 0 && {speed} < 1e-3")
            self.assertEqual(tab.run("state.phase"), "running")
        self.choose(tab, "circle", 0.5)
        tab.wait(f"state.curve && {asked} > 0.05")
        # Also while a field has the focus.
        tab.run("document.getElementById('scale').focus()")
        tab.key("keyDown", " ", "Space")
        tab.wait(f"state.phase === 'idle' && {asked} === 0")

    def test_the_plot_is_zoomed_over_time(self):
        tab = self.started()
        tab.key("keyDown", "i", "KeyI")
        tab.wait(f"{speed} > 0.4")
        tab.key("keyUp", "i", "KeyI")
        tab.wait(f"{speed} < 1e-3")
        x, y, width = tab.middle("plot")
        tab.call("Input.dispatchMouseEvent", type="mouseWheel", x=x, y=y, deltaX=0, deltaY=-400)
        # By e, about what is under the mouse: the middle of the minute.
        tab.wait("Math.abs(view.seconds - 60 / Math.E) < 0.1")
        ago = tab.run("view.ago")
        self.assertAlmostEqual(ago, 30 * (1 - 1 / math.e), delta=0.5)
        tab.mouse("mousePressed", x, y)
        tab.mouse("mouseMoved", x - width / 2, y)
        tab.mouse("mouseReleased", x - width / 2, y)
        tab.wait(f"Math.abs(view.ago - ({ago} - view.seconds / 2)) < 0.2")
        self.assertIn("ago", tab.run("document.getElementById('plot-title').textContent"))
        tab.run("document.getElementById('plot').dispatchEvent(new MouseEvent('dblclick'))")
        self.assertEqual(tab.run("[view.seconds, view.ago]"), [60, 0])
        for _ in range(3):
            tab.click("shorter")
        self.assertEqual(tab.run("document.getElementById('plot-title').textContent"), "Speed, last 8 s")
        tab.picture(PICTURES / "page-plot.png")
        for _ in range(10):
            tab.click("longer")
        self.assertEqual(tab.run("document.getElementById('plot-title').textContent"), "Speed, last 10.0 min")

    def test_the_mouse_zooms_and_moves_the_map(self):
        tab = self.started()
        x, y, _ = tab.middle("map")
        scale = tab.run("look.scale")
        tab.call("Input.dispatchMouseEvent", type="mouseWheel", x=x, y=y, deltaX=0, deltaY=-200)
        tab.wait(f"look.scale > 1.5 * {scale} && look.near <= 8")
        before = tab.run("centre.slice()")
        tab.mouse("mousePressed", x, y)
        tab.mouse("mouseMoved", x + 50, y + 20)
        tab.mouse("mouseReleased", x + 50, y + 20)
        # Forward is up and left is left: what is under the mouse stays there.
        tab.wait("look.moved")
        moved = tab.run(f"[(centre[0] - {before[0]}) * look.scale, (centre[1] - {before[1]}) * look.scale]")
        self.assertAlmostEqual(moved[0], 20, delta=1)
        self.assertAlmostEqual(moved[1], 50, delta=1)
        tab.picture(PICTURES / "page-map.png")
        tab.run("document.getElementById('map').dispatchEvent(new MouseEvent('dblclick'))")
        tab.wait("!look.moved && look.near === 1")

    def test_who_looks_away_does_not_drive(self):
        tab = self.started()
        for loss in ["window.dispatchEvent(new Event('blur'))", "window.dispatchEvent(new Event('pagehide'))"]:
            tab.key("keyDown", "i", "KeyI")
            tab.wait("state.command[0] > 0.4")
            tab.run(loss)
            tab.wait(f"{asked} === 0 && {speed} < 1e-3")
            self.assertEqual(tab.run("state.phase"), "running")
            tab.key("keyUp", "i", "KeyI")

    def test_a_page_that_dies_ramps_down(self):
        viewer = self.client()
        tab = self.started()
        tab.key("keyDown", "i", "KeyI")
        viewer.until("motion", lambda: viewer.states[-1]["command"][0] > 0.4)
        tab.call("Page.navigate", url="about:blank")
        viewer.until("robots off", lambda: viewer.states[-1]["phase"] == "idle")

    def test_a_phone_drives_by_touch(self):
        tab = self.started(width=390, height=844, mobile=True, dark=True)
        self.fits(tab)
        x, y, width = tab.middle("move")
        tab.touch("touchStart", (x, y))
        tab.touch("touchMove", (x + width / 3, y))
        tab.wait("state.command[1] < -0.3 && state.pose[1] < -0.3")
        self.fits(tab)
        tab.run("window.scrollTo(0, 0)")
        tab.picture(PICTURES / "page-390.png")
        tab.touch("touchEnd")
        tab.wait(f"{asked} === 0 && {speed} < 1e-3")


class Report(unittest.TestCase):
    """The file of `omnibus follow --report`, without any server."""

    def setUp(self):
        self.browser = Browser()
        self.addCleanup(self.browser.close)
        folder = tempfile.TemporaryDirectory()
        self.addCleanup(folder.cleanup)
        file = pathlib.Path(folder.name) / "report.html"
        command = [os.environ["OMNIBUS"], "follow", "lateral", "--quick", "--quiet", "--report", str(file)]
        subprocess.run([*command, "--bus", f"sim:{ROOT / 'groups' / 'tcc-2.toml'}"], check=True, timeout=PATIENCE)
        self.tab = Tab(self.browser, file.as_uri())
        self.addCleanup(self.tab.close)
        self.tab.wait("document.querySelectorAll('figure[data-plot]').length > 3")
        # The second chart: the first is the map.
        self.tab.run("window.chart = document.querySelectorAll('figure[data-plot]')[1]; chart.scrollIntoView({block: 'center'})")
        self.plot = [float(number) for number in self.tab.run("chart.dataset.plot").split()]

    def at(self, across, down):
        """Where on the window a place of the plot is, in shares of it."""
        left, right, top, bottom = self.plot[:4]
        x, y = left + across * (right - left), top + down * (bottom - top)
        return self.tab.run(f"""(() => {{
            const svg = chart.querySelector('svg'), box = svg.getBoundingClientRect();
            const [x, y, width, height] = svg.getAttribute('viewBox').split(' ').map(Number);
            return [box.left + ({x} - x) / width * box.width, box.top + ({y} - y) / height * box.height];
        }})()""")

    def drag(self, start, end):
        (x, y), (to_x, to_y) = self.at(*start), self.at(*end)
        self.tab.mouse("mousePressed", x, y)
        self.tab.mouse("mouseMoved", (x + to_x) / 2, (y + to_y) / 2)
        self.assertFalse(self.tab.run("chart.querySelector('.box').hidden"))
        self.tab.mouse("mouseReleased", to_x, to_y)

    def view(self):
        return [float(n) for n in self.tab.run("chart.querySelector('svg').getAttribute('viewBox')").split()]

    def test_charts_are_zoomed_by_dragging_over_them(self):
        left, right, top, bottom, x0, x1, y0, y1 = self.plot
        whole, size = self.view(), self.tab.run("chart.querySelector('svg').getBoundingClientRect().height")
        self.drag((0.25, 0.5), (0.5, 0.5))
        # Sideways: a quarter of the time, and the whole height.
        expected = [left + 0.25 * (right - left), top, 0.25 * (right - left), bottom - top]
        for found, wanted in zip(self.view(), expected):
            self.assertAlmostEqual(found, wanted, delta=0.01 * (right - left))
        self.assertAlmostEqual(self.tab.run("chart.querySelector('svg').getBoundingClientRect().height"), size, delta=1)
        labels = [float(text) for text in self.tab.run("[...chart.querySelectorAll('.ticks span')].map((one) => one.textContent)")]
        self.assertAlmostEqual(labels[0], x0 + (0.25 + 0.25 / 6) * (x1 - x0), delta=0.01 * (x1 - x0))
        self.assertAlmostEqual(labels[1], y1 - (y1 - y0) / 6, delta=0.02 * (y1 - y0))
        self.tab.picture(PICTURES / "report-zoomed.png")
        # A rectangle within that.
        self.drag((0.3, 0.2), (0.4, 0.6))
        expected = [left + 0.3 * (right - left), top + 0.2 * (bottom - top), 0.1 * (right - left), 0.4 * (bottom - top)]
        for found, wanted in zip(self.view(), expected):
            self.assertAlmostEqual(found, wanted, delta=0.01 * (right - left))
        self.tab.run("chart.querySelector('svg').dispatchEvent(new MouseEvent('dblclick'))")
        self.assertEqual(self.view(), whole)
        self.assertEqual(self.tab.run("chart.querySelectorAll('.ticks span').length"), 0)


if __name__ == "__main__":
    unittest.main()
