"""`omnibus update` from the command line, as docs/operating.md has it, on three emulated robots that stay.

Each command is a process of its own on a bus whose time waits for it (`lockstep.py`). Ctrl-C comes when the command has
said what it does.
"""

import os
import pathlib
import re
import signal
import subprocess
import unittest

from robot import PATIENCE, ROOT

GROUP = ROOT / "groups" / "tcc-3.toml"
NODES = (2, 3, 4)
IMAGE = pathlib.Path(os.environ["OMNIBUS_IMAGE"])
STOPPED = 130
"""Exit code after Ctrl-C."""
LONG = 10 * PATIENCE


class UpdateCommand(unittest.TestCase):
    def setUp(self):
        command = [os.environ["OMNIBUS_SIM"], "serve", GROUP, "--lockstep", "127.0.0.1:0"]
        command += ["--backend", "emulator", "--elf", os.environ["OMNIBUS_ELF"]]
        self.process = subprocess.Popen(command, stdout=subprocess.PIPE, text=True)
        self.addCleanup(self.end)
        name, address = self.process.stdout.readline().split()
        self.assertEqual(name, "lockstep")
        self.bus = f"lockstep://{address}"

    def end(self):
        self.process.send_signal(signal.SIGINT)
        self.process.stdout.close()
        self.assertEqual(self.process.wait(PATIENCE), 0)

    def command(self, arguments):
        return [os.environ["OMNIBUS"], "update", *map(str, arguments), "--bus", self.bus]

    def update(self, *arguments):
        done = subprocess.run(
            self.command(arguments), capture_output=True, text=True, timeout=LONG
        )
        return done.returncode, done.stdout, done.stderr

    def slots(self):
        code, result, notes = self.update(IMAGE, "--dry-run", "--group", GROUP)
        self.assertEqual((code, result), (0, "nothing was changed\n"), notes)
        self.assertNotIn("erases", notes)
        found = re.findall(r"^node (\d+): version [\d.]+ in slot ([AB]), gets", notes, re.M)
        self.assertEqual([int(node) for node, _ in found], list(NODES), notes)
        return "".join(slot for _, slot in found)

    def interrupted(self, line):
        """An update, and Ctrl-C once it has said this line."""
        command = self.command([IMAGE, "--group", GROUP])
        process = subprocess.Popen(
            command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
        )
        notes = []
        for said in process.stderr:
            notes.append(said)
            if said == line + "\n":
                process.send_signal(signal.SIGINT)
                break
        result, rest = process.communicate(timeout=LONG)
        return process.returncode, result, "".join(notes) + rest

    def test_the_commands_of_the_page_in_their_order(self):
        page = (ROOT / "docs" / "operating.md").read_text()
        commands = re.findall(r"^omnibus update (.*)$", page, re.M)
        self.assertEqual(len(commands), 3, commands)
        outcomes = []
        for command in commands:
            words = command.replace("--bus socketcan:can0", "").split()
            words = [{"omnibus.image": IMAGE, "groups/tcc-3.toml": GROUP}.get(w, w) for w in words]
            code, result, notes = self.update(*words)
            self.assertEqual(code, 0, notes)
            outcomes.append((result.strip(), self.slots()))
        self.assertEqual(
            outcomes,
            [
                ("nothing was changed", "AAA"),
                ("all robots run the new image", "BBB"),
                ("all robots run their previous image", "AAA"),
            ],
        )
        code, result, notes = self.update(IMAGE, "--node", 3)
        self.assertEqual(code, 0, notes)
        self.assertEqual(self.slots(), "ABA")
        code, result, notes = self.update("--rollback", "--node", 3)
        self.assertEqual(code, 0, notes)
        self.assertEqual(self.slots(), "AAA")
        # Where it has come from is rejected: there is nothing to go back to.
        code, result, notes = self.update("--rollback")
        self.assertEqual((code, result), (4, ""), notes)
        self.assertIn("its other image was rejected", notes)
        self.assertEqual(self.slots(), "AAA")

    def test_ctrl_c_in_a_transfer_leaves_all_as_they_are(self):
        code, result, notes = self.interrupted("node 3: erases its slot")
        self.assertEqual((code, result), (STOPPED, ""), notes)
        self.assertIn("stopped on request", notes)
        self.assertNotIn("starts the new image", notes)
        self.assertEqual(self.slots(), "AAA")
        code, result, notes = self.update(IMAGE, "--group", GROUP)
        self.assertEqual((code, result), (0, "all robots run the new image\n"), notes)
        self.assertEqual(self.slots(), "BBB")

    def test_ctrl_c_in_a_trial_leaves_all_with_one_image(self):
        # Ctrl-C comes before the first confirmation or, on a busy machine, after it.
        code, _, notes = self.interrupted("node 2: starts it")
        stayed = code == STOPPED
        self.assertIn(code, (0, STOPPED), notes)
        self.assertEqual(self.slots(), "AAA" if stayed else "BBB", notes)
        if stayed:
            self.assertIn("node 2: goes back", notes)
            self.assertNotIn("confirmed", notes)


if __name__ == "__main__":
    unittest.main()
