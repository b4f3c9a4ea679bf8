"""A page in headless Chromium, driven over the DevTools protocol; and a page without a browser."""

import base64
import json
import pathlib
import shutil
import subprocess
import tempfile
import time

from websockets.sync.client import connect

PATIENCE = 30.0
FLAGS = [
    "--headless", "--no-sandbox", "--disable-gpu", "--disable-quic", "--no-first-run",
    "--disable-background-networking", "--disable-component-update", "--disable-sync",
    "--disable-dev-shm-usage", "--remote-debugging-port=0",
]


def wait(what, question):
    """What `question` answers, once that is true."""
    end = time.monotonic() + PATIENCE
    while time.monotonic() < end:
        answer = question()
        if answer:
            return answer
        time.sleep(0.02)
    raise AssertionError(f"not within {PATIENCE} s: {what}")


class Browser:
    def __init__(self):
        self.folder = tempfile.mkdtemp(prefix="omnibus-page-")
        program = next(filter(shutil.which, ["chromium", "chromium-browser", "google-chrome"]))
        self.process = subprocess.Popen(
            [program, *FLAGS, f"--user-data-dir={self.folder}", "about:blank"],
            stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL,
        )
        port = pathlib.Path(self.folder, "DevToolsActivePort")
        lines = wait("the browser", lambda: port.exists() and port.read_text().split("\n")[1:] and port.read_text().split("\n"))
        self.socket = connect(f"ws://127.0.0.1:{lines[0]}{lines[1]}", max_size=None, compression=None)
        self.last = 0

    def call(self, method, session=None, **parameters):
        self.last += 1
        message = {"id": self.last, "method": method, "params": parameters}
        if session:
            message["sessionId"] = session
        self.socket.send(json.dumps(message))
        while True:
            answer = json.loads(self.socket.recv(timeout=PATIENCE))
            if answer.get("id") == self.last:
                if "error" in answer:
                    raise AssertionError(f"{method}: {answer['error']}")
                return answer["result"]

    def close(self):
        self.socket.close()
        self.process.terminate()
        self.process.wait(PATIENCE)
        shutil.rmtree(self.folder, ignore_errors=True)


class Tab:
    """One page. Coordinates are those of the page's middle of an element."""

    def __init__(self, browser, url, width=1280, height=900, mobile=False, dark=False):
        self.browser = browser
        # A window of its own, so that several pages have the focus at once, as on several machines.
        self.context = browser.call("Target.createBrowserContext")["browserContextId"]
        self.target = browser.call("Target.createTarget", url="about:blank", browserContextId=self.context)["targetId"]
        self.session = browser.call("Target.attachToTarget", targetId=self.target, flatten=True)["sessionId"]
        self.call("Emulation.setFocusEmulationEnabled", enabled=True)
        self.call("Emulation.setDeviceMetricsOverride", width=width, height=height, deviceScaleFactor=1, mobile=mobile)
        if mobile:
            self.call("Emulation.setTouchEmulationEnabled", enabled=True)
        if dark:
            self.call("Emulation.setEmulatedMedia", features=[{"name": "prefers-color-scheme", "value": "dark"}])
        self.call("Page.navigate", url=url)

    def call(self, method, **parameters):
        return self.browser.call(method, self.session, **parameters)

    def run(self, script):
        answer = self.call("Runtime.evaluate", expression=script, returnByValue=True)
        if "exceptionDetails" in answer:
            raise AssertionError(f"{script}: {answer['exceptionDetails']}")
        return answer["result"].get("value")

    def wait(self, script):
        return wait(script, lambda: self.run(script))

    def click(self, element):
        self.run(f"document.getElementById('{element}').click()")

    def middle(self, element):
        # The page may have to be scrolled to it.
        return self.run(
            f"(() => {{ const e = document.getElementById('{element}'); e.scrollIntoView({{block: 'center'}});"
            "const b = e.getBoundingClientRect(); return [b.x + b.width / 2, b.y + b.height / 2, b.width]; })()"
        )

    def mouse(self, kind, x, y):
        self.call("Input.dispatchMouseEvent", type=kind, x=x, y=y, button="left", buttons=0 if kind == "mouseReleased" else 1, clickCount=1)

    def touch(self, kind, *points):
        self.call("Input.dispatchTouchEvent", type=kind, touchPoints=[{"x": x, "y": y} for x, y in points])

    def key(self, kind, key, code):
        self.call("Input.dispatchKeyEvent", type=kind, key=key, code=code)

    def picture(self, path):
        data = self.call("Page.captureScreenshot", captureBeyondViewport=True)["data"]
        pathlib.Path(path).write_bytes(base64.b64decode(data))

    def close(self):
        self.browser.call("Target.closeTarget", targetId=self.target)


class Client:
    """What a page says and hears, without a browser."""

    def __init__(self, address, token=None, **options):
        self.socket = connect(f"ws://{address}/ws", max_size=None, compression=None, **options)
        self.states = []
        self.refusals = []
        self.events = []
        self.seat = None
        if token is not None:
            self.say(type="hello", token=token)

    def say(self, **message):
        self.socket.send(json.dumps(message))

    def hear(self, seconds=0.0):
        """Takes in what is there, and what comes in so many seconds."""
        end = time.monotonic() + seconds
        while True:
            try:
                message = json.loads(self.socket.recv(timeout=max(0.001, end - time.monotonic())))
            except TimeoutError:
                return
            if message["type"] == "state":
                self.states.append(message)
            elif message["type"] == "refused":
                self.refusals.append(message["reason"])
            elif message["type"] == "event":
                self.events.append(message["text"])
            elif message["type"] == "seat":
                self.seat = message
            if time.monotonic() > end + 1:
                return

    def until(self, what, question):
        def look():
            self.hear(0.02)
            return question()

        return wait(what, look)

    def drive(self, press, vx, **more):
        message = {"vx": vx, "vy": 0, "omega": 0, "clock": self.states[-1]["clock"], **more}
        self.say(type="drive", press=press, **message)

    def start(self):
        self.say(type="take")
        self.say(type="start")
        self.until("running", lambda: self.states and self.states[-1]["phase"] == "running")
