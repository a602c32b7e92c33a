#!/usr/bin/python3
"""Closes Feedwright's loop on a LinuxCNC machine: samples it, streams to the server, writes the feed override.

A userspace HAL component; README.md has its pins, its configuration and how it is wired. Standard library only,
beside LinuxCNC's own `hal` and `linuxcnc` modules.

Three parts, apart from each other:
  Envelope   decides what override is applied. Knows no network: an answer that is not a finite number within the
             limits, or that is too old, does not exist for it; without answers it goes back to 100 %.
  Stream     a thread that talks `feedwright.v1` over a WebSocket, and keeps every cycle until it is stored.
  main       the 100 Hz loop: reads pins, hands samples to the stream, writes pins.
"""

import argparse
import base64
import collections
import hashlib
import json
import math
import os
import signal
import socket
import ssl
import struct
import subprocess
import sys
import threading
import time
import urllib.parse

PERIOD_S = 0.010
CHANNELS = [
    "depth_mm",
    "feed_programmed_mm_min",
    "feed_actual_mm_min",
    "override_percent",
    "feed_drive_load_percent",
    "spindle_load_percent",
    "spindle_speed_rpm",
]
MOST_SAMPLES = 60_000  # as the server's stream.samples_per_cycle
MOST_KEPT_CYCLES = 50  # cycles that wait to be stored; the oldest goes first
MOST_PER_MESSAGE = 100  # below the server's stream.samples_per_message
MOST_VALID_MS = 5_000  # no answer is believed for longer, whatever it says
ANSWER_TIMEOUT_S = 3.0
RECONNECT_S = 0.5


class Envelope:
    """The override that is applied, percent. Thread-safe; `now` is a monotonic time in seconds."""

    def __init__(self, low, high, rise_points_per_s=500.0, on_loss="ramp"):
        if not (0.0 < low <= 100.0 <= high <= 255.0):
            raise ValueError("the override limits must contain 100 and begin above 0")
        self.low, self.high, self.rise, self.on_loss = low, high, rise_points_per_s, on_loss
        self.lock = threading.Lock()
        self.applied = 100.0
        self.wish, self.expires, self.overload = None, 0.0, False
        self.refused = 0
        self.stepped = None
        self.followed = None  # the answer that the last step went by: its override, and until when it holds

    def begin(self):
        """A new cycle starts at 100 %."""
        with self.lock:
            self.applied, self.wish, self.overload = 100.0, None, False

    def answer(self, sent, percent, valid_for_ms, overload):
        """Takes an answer to what was sent at `sent`. Returns whether it is believed."""
        good = (
            is_number(percent)
            and self.low <= percent <= self.high
            and is_number(valid_for_ms)
            and 0.0 <= valid_for_ms <= MOST_VALID_MS
        )
        with self.lock:
            if overload is True:
                self.overload = True
            if not good:
                # What cannot be true may have been meant for anything: no wish at all.
                self.wish = None
                self.refused += 1
                return False
            if overload is False:
                self.overload = False
            # The answer's age counts from when its question was sent: later than that it cannot have been made.
            self.wish, self.expires = float(percent), sent + valid_for_ms / 1000.0
            return True

    def step(self, now):
        """The override to apply now: down at once, up no faster than the permitted points."""
        with self.lock:
            passed = min(0.1, max(0.0, now - self.stepped)) if self.stepped is not None else 0.0
            self.stepped = now
            self.followed = (self.wish, self.expires) if self.wish is not None and now < self.expires else None
            if self.followed:
                target = self.wish
            elif self.overload or (self.on_loss == "hold" and self.applied <= 100.0):
                # Never up while an overload is not acknowledged; and never above 100 without an answer.
                target = min(self.applied, 100.0)
            else:
                target = 100.0
            self.applied = min(target, self.applied + self.rise * passed)
            self.applied = min(max(self.applied, self.low), self.high)
            return self.applied


def is_number(value):
    return isinstance(value, (int, float)) and not isinstance(value, bool) and math.isfinite(value)


class WebSocket:
    """As much of RFC 6455 as a client needs, over a blocking socket."""

    def __init__(self, url, token, timeout):
        parts = urllib.parse.urlsplit(url)
        port = parts.port or (443 if parts.scheme == "https" else 80)
        self.socket = socket.create_connection((parts.hostname, port), timeout)
        self.socket.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        if parts.scheme == "https":
            self.socket = ssl.create_default_context().wrap_socket(self.socket, server_hostname=parts.hostname)
        key = base64.b64encode(os.urandom(16)).decode()
        self.socket.sendall(
            (
                f"GET {parts.path} HTTP/1.1\r\nHost: {parts.hostname}:{port}\r\nUpgrade: websocket\r\n"
                f"Connection: Upgrade\r\nSec-WebSocket-Key: {key}\r\nSec-WebSocket-Version: 13\r\n"
                f"Sec-WebSocket-Protocol: feedwright.v1\r\nAuthorization: Bearer {token}\r\n\r\n"
            ).encode()
        )
        self.buffer = b""
        while b"\r\n\r\n" not in self.buffer:
            self._more()
            if len(self.buffer) > 65_536:
                raise ConnectionError("the answer to the upgrade has no end")
        head, self.buffer = self.buffer.split(b"\r\n\r\n", 1)
        lines = head.decode("latin-1").split("\r\n")
        headers = {name.strip().lower(): value.strip() for name, _, value in (line.partition(":") for line in lines[1:])}
        accept = base64.b64encode(hashlib.sha1((key + "258EAFA5-E914-47DA-95CA-C5AB0DC85B11").encode()).digest()).decode()
        if lines[0].split(" ")[1:2] != ["101"] or headers.get("sec-websocket-accept") != accept:
            raise ConnectionError(f"not upgraded: {lines[0]}")

    def _more(self):
        data = self.socket.recv(65_536)
        if not data:
            raise ConnectionError("the server closed the connection")
        self.buffer += data

    def _take(self, count):
        while len(self.buffer) < count:
            self._more()
        data, self.buffer = self.buffer[:count], self.buffer[count:]
        return data

    def send(self, text, opcode=1):
        payload = text.encode() if isinstance(text, str) else text
        length = len(payload)
        if length < 126:
            head = struct.pack("!BB", 0x80 | opcode, 0x80 | length)
        elif length < 65_536:
            head = struct.pack("!BBH", 0x80 | opcode, 0x80 | 126, length)
        else:
            head = struct.pack("!BBQ", 0x80 | opcode, 0x80 | 127, length)
        mask = os.urandom(4)
        repeated = mask * (length // 4 + 1)
        masked = (int.from_bytes(payload, "big") ^ int.from_bytes(repeated[:length], "big")).to_bytes(length, "big")
        self.socket.sendall(head + mask + masked)

    def receive(self, timeout):
        """The next text message; `None` where none came in time."""
        self.socket.settimeout(timeout)
        message = b""
        while True:
            try:
                first, second = self._take(2)
            except TimeoutError:
                return None
            length = second & 0x7F
            if length == 126:
                (length,) = struct.unpack("!H", self._take(2))
            elif length == 127:
                (length,) = struct.unpack("!Q", self._take(8))
            if length > 4_000_000:
                raise ConnectionError("a message that no server of ours sends")
            payload = self._take(length)
            opcode = first & 0x0F
            if opcode == 9:
                self.send(payload, 10)
            elif opcode == 8:
                raise ConnectionError(f"closed by the server: {payload[2:].decode(errors='replace')}")
            elif opcode in (0, 1):
                message += payload
                if first & 0x80:
                    return message.decode()

    def close(self):
        try:
            self.socket.close()
        except OSError:
            pass


class Cycle:
    """A cycle with all its samples, kept until it is stored."""

    def __init__(self, number, operation, now):
        self.id = f"{BOOT}:{number:06d}"
        self.seq = number
        self.operation = operation
        self.wall, self.begun = time.time(), now
        self.samples = []
        self.sent = 0
        self.ended = False
        self.started = False
        self.again = False  # was started before, by a server that may not know it any more


BOOT = time.strftime("%Y%m%dT%H%M%SZ", time.gmtime())


def rfc3339(wall):
    return time.strftime("%Y-%m-%dT%H:%M:%S", time.gmtime(wall)) + f".{int(wall % 1 * 1e6):06d}Z"


class Stream(threading.Thread):
    """Sends what the loop hands over, and gives what is answered to the envelope."""

    def __init__(self, config, envelope, log):
        super().__init__(daemon=True)
        self.config, self.envelope, self.log = config, envelope, log
        self.url = f"{config['server'].rstrip('/')}/v1/machines/{config['machine']}/stream"
        with open(config["token_file"], encoding="utf-8") as file:
            self.token = file.read().strip()
        self.cycles = collections.deque()
        self.news = threading.Condition()
        self.connected = False
        self.stored = 0
        self.n = 0

    def begin(self, cycle):
        with self.news:
            self.cycles.append(cycle)
            while len(self.cycles) > MOST_KEPT_CYCLES:
                lost = self.cycles.popleft()
                self.log(f"cycle {lost.id} could not be stored and is given up")
            self.news.notify()

    def add(self, cycle, sample):
        with self.news:
            if len(cycle.samples) < MOST_SAMPLES:
                cycle.samples.append(sample)
            self.news.notify()

    def end(self, cycle):
        with self.news:
            cycle.ended = True
            self.news.notify()

    def run(self):
        while True:
            socket_ = None
            try:
                socket_ = WebSocket(self.url, self.token, ANSWER_TIMEOUT_S)
                self.connected = True
                self.serve(socket_)
            except (OSError, ValueError, KeyError, TypeError) as error:
                self.log(f"stream: {error}")
            self.connected = False
            if socket_ is not None:
                socket_.close()
            time.sleep(RECONNECT_S)

    def serve(self, socket_):
        with self.news:
            waiting = list(self.cycles)
        for cycle in waiting:
            # What this server holds of the cycle is its to say; what was running elsewhere is sent again.
            self.resume(socket_, cycle)
            if not cycle.ended:
                break
            self.work(socket_, cycle, until_stored=True)
        while True:
            with self.news:
                if not self.cycles:
                    self.news.wait(1.0)
                cycle = self.cycles[0] if self.cycles else None
            if cycle is None:
                self.ask(socket_, {"type": "heartbeat"})
            else:
                self.work(socket_, cycle)

    def resume(self, socket_, cycle):
        if not cycle.started:
            return
        answer, _ = self.ask(socket_, {"type": "resume", "cycle_id": cycle.id})
        if answer["type"] == "stored":
            self.settled(cycle)
        elif answer["type"] == "resumed" and "resume_from" in answer:
            cycle.sent = int(answer["resume_from"])
        else:
            cycle.started, cycle.again, cycle.sent = False, True, 0

    def work(self, socket_, cycle, until_stored=False):
        """Starts the cycle where it was not, sends what is new of it, and ends it; one step of it, or all."""
        while True:
            if not cycle.started:
                self.start_cycle(socket_, cycle)
            with self.news:
                if cycle.sent >= len(cycle.samples) and not cycle.ended:
                    self.news.wait(1.0)
                group = cycle.samples[cycle.sent : cycle.sent + MOST_PER_MESSAGE]
                done = cycle.ended and cycle.sent + len(group) >= len(cycle.samples)
            if group:
                columns = list(zip(*group))
                message = {"type": "samples", "first": cycle.sent, "time_ms": columns[0]}
                message.update(zip(CHANNELS, columns[1:]))
                answer, sent = self.ask(socket_, message)
                cycle.sent += len(group)
                if answer["type"] == "error":
                    self.log(f"samples refused: {answer.get('code')}: {answer.get('detail')}")
                    answer = answer.get("standing") or {}
                if not cycle.ended and answer.get("mode") != "shadow":
                    self.envelope.answer(
                        sent, answer.get("override_percent"), answer.get("valid_for_ms"), answer.get("overload")
                    )
            elif not done:
                # Nothing new for a second: the machine stands in mid-cycle.
                self.ask(socket_, {"type": "heartbeat"})
            if done and self.end_cycle(socket_, cycle):
                return
            if not until_stored:
                return

    def start_cycle(self, socket_, cycle):
        what = cycle.operation
        message = {
            "type": "start",
            "cycle_id": cycle.id,
            "seq": cycle.seq,
            "tool": what["tool"],
            "operation": what["operation"],
            "started_at": rfc3339(cycle.wall),
            "sent_at": rfc3339(cycle.wall + time.monotonic() - cycle.begun),
            "usual_period_ms": PERIOD_S * 1000,
            "channels": CHANNELS,
        }
        for name in ("mode", "program", "profile", "strategy", "spindle_speed_rpm", "law_version"):
            if name in what:
                message[name] = what[name]
        late = time.monotonic() - cycle.begun > 1.0
        if cycle.again or late:
            message["resend"] = True
            message["in_force_percent"] = self.envelope.applied
        answer, _ = self.ask(socket_, message)
        if answer["type"] != "started":
            self.log(f"cycle {cycle.id} refused: {answer.get('code')}: {answer.get('detail')} {answer.get('errors')}")
            if answer.get("status", 500) < 500:
                self.settled(cycle)
            raise ConnectionError("the cycle was not started")
        cycle.started = True

    def end_cycle(self, socket_, cycle):
        answer, _ = self.ask(socket_, {"type": "end", "cycle_id": cycle.id, "samples": len(cycle.samples)})
        if answer["type"] == "stored" or answer.get("quarantine_id"):
            self.settled(cycle)
            self.stored += answer["type"] == "stored"
            return True
        self.log(f"cycle {cycle.id} not stored: {answer.get('code')}: {answer.get('detail')}")
        if answer.get("code") == "samples_missing":
            self.resume(socket_, cycle)
        time.sleep(min(5, answer.get("retry_after_s") or 1))
        return False

    def settled(self, cycle):
        with self.news:
            if cycle in self.cycles:
                self.cycles.remove(cycle)

    def ask(self, socket_, message):
        """Sends a message and waits for the answer that names it; the answer, and when the message was sent."""
        self.n = self.n % 4_000_000_000 + 1
        message["n"] = self.n
        sent = time.monotonic()
        socket_.send(json.dumps(message))
        while True:
            text = socket_.receive(ANSWER_TIMEOUT_S)
            if text is None:
                raise ConnectionError("no answer")
            answer = json.loads(text)
            if answer.get("re") == self.n:
                return answer, sent


class Twin:
    """Loads from the process model, where the machine has no drives that could tell theirs: a simulated LinuxCNC."""

    def __init__(self, command):
        self.process = subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True, bufsize=1)

    def ask(self, line):
        self.process.stdin.write(json.dumps(line) + "\n")
        answer = json.loads(self.process.stdout.readline())
        if "error" in answer:
            raise ValueError(f"the process model refuses {line}: {answer['error']}")
        return answer

    def new_hole(self, rpm):
        self.ask({"new_hole": {}})
        # The spindle runs already when a hole begins; the model would see it spin up from rest.
        self.loads(-1.0, 0.0, rpm, 1.0)

    def loads(self, depth_mm, feed_mm_min, rpm, passed_s):
        answer = self.ask({"depth_mm": depth_mm, "feed_mm_min": feed_mm_min, "spindle_rpm": rpm, "dt_s": passed_s})
        return answer["feed_drive_percent"], answer["spindle_percent"]


class FeedOverride:
    """Sets LinuxCNC's feed override. The task takes about ten milliseconds to answer, and holds Python for as long: so
    a process of its own does it, and always takes the last wish."""

    def __init__(self):
        command = [sys.executable, os.path.abspath(__file__), "--feed-override"]
        self.process = subprocess.Popen(command, stdin=subprocess.PIPE, bufsize=0)
        self.asked = 1.0

    def set(self, factor):
        if abs(factor - self.asked) > 1e-4:
            self.process.stdin.write(struct.pack("d", factor))
            self.asked = factor

    def close(self):
        """Ends it; it resets the feed override where LinuxCNC still answers, and is not waited for for ever."""
        self.process.stdin.close()
        try:
            self.process.wait(5)
        except subprocess.TimeoutExpired:
            self.process.kill()
            self.process.wait()

    @staticmethod
    def serve():
        import linuxcnc

        command = linuxcnc.command()
        while wishes := os.read(0, 65_536):
            command.feedrate(struct.unpack("d", wishes[-8:])[0])
        # Whoever asked for more is gone.
        command.feedrate(1.0)


def component(hal):
    made = hal.component("feedwright")
    for name in ("z", "feed-programmed", "velocity", "spindle-speed", "operation", "feed-drive-load", "spindle-load"):
        made.newpin(name, hal.HAL_FLOAT, hal.HAL_IN)
    made.newpin("cutting", hal.HAL_BIT, hal.HAL_IN)
    made.newpin("adaptive-feed", hal.HAL_FLOAT, hal.HAL_OUT)
    made.newpin("override", hal.HAL_FLOAT, hal.HAL_OUT)
    for name in ("connected", "overload"):
        made.newpin(name, hal.HAL_BIT, hal.HAL_OUT)
    for name in ("stored", "refused"):
        made.newpin(name, hal.HAL_U32, hal.HAL_OUT)
    made["adaptive-feed"], made["override"] = 1.0, 100.0
    made.ready()
    return made


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("config", help="JSON file; README.md describes it")
    parser.add_argument("--trace", metavar="FILE", help="writes a line per sample, for looking at it later")
    arguments = parser.parse_args()
    with open(arguments.config, encoding="utf-8") as file:
        config = json.load(file)

    import hal

    def log(text):
        print(f"feedwright: {text}", file=sys.stderr, flush=True)

    limits = config.get("override_limits_percent", [20.0, 100.0])
    envelope = Envelope(limits[0], limits[1], on_loss=config.get("on_loss", "ramp"))
    stream = Stream(config, envelope, log)
    twin = Twin(config["twin"]) if config.get("twin") else None
    trace = open(arguments.trace, "w", buffering=1, encoding="utf-8") if arguments.trace else None
    pins = component(hal)
    feed_override = FeedOverride() if limits[1] > 100.0 else None
    stream.start()

    def stop(*_):
        raise KeyboardInterrupt

    # LinuxCNC ends its components so.
    signal.signal(signal.SIGTERM, stop)
    cycle, number, passed = None, 0, PERIOD_S
    due = last = time.monotonic()
    try:
        while True:
            now = time.monotonic()
            passed, last = now - last, now
            if pins["cutting"] and cycle is None:
                operation = config["operations"].get(str(round(pins["operation"])))
                if operation is not None:
                    number += 1
                    cycle = Cycle(number, operation, now)
                    envelope.begin()
                    if twin:
                        twin.new_hole(abs(pins["spindle-speed"]))
                    stream.begin(cycle)
            elif not pins["cutting"] and cycle is not None:
                stream.end(cycle)
                cycle = None
            applied = envelope.step(now) if cycle is not None else 100.0
            # Never above 1, where the pin is clamped anyway, and never 0 or less: those hold or run backwards.
            pins["adaptive-feed"] = min(max(applied, limits[0]), 100.0) / 100.0
            pins["override"] = applied
            if feed_override:
                # Above 100 % there is only the feed override, which multiplies.
                feed_override.set(max(1.0, applied / 100.0))
            if cycle is not None and passed > 0.0:
                depth = config.get("surface_z_mm", 0.0) - pins["z"]
                programmed = pins["feed-programmed"] * 60.0
                actual = abs(pins["velocity"]) * 60.0
                rpm = abs(pins["spindle-speed"])
                if twin:
                    loads = twin.loads(depth, actual, rpm, passed)
                else:
                    loads = (pins["feed-drive-load"], pins["spindle-load"])
                at = (now - cycle.begun) * 1000.0
                sample = (round(at, 3), round(depth, 4), round(programmed, 3), round(actual, 3),
                          round(applied, 3), round(loads[0], 2), round(loads[1], 2), round(rpm, 1))
                stream.add(cycle, sample)
                if trace:
                    followed = envelope.followed or (None, None)
                    trace.write(json.dumps([cycle.id, now, *sample, *followed]) + "\n")
            pins["connected"], pins["overload"] = stream.connected, envelope.overload
            pins["stored"], pins["refused"] = stream.stored, envelope.refused
            # On a fixed grid: a period that was missed is left out, not made up for.
            due += PERIOD_S * max(1, math.ceil((time.monotonic() - due) / PERIOD_S))
            time.sleep(max(0.0, due - time.monotonic()))
    except KeyboardInterrupt:
        pass
    finally:
        # A process that outlives LinuxCNC takes the next one's shared memory along when it ends.
        if feed_override:
            feed_override.close()


if __name__ == "__main__":
    if sys.argv[1:] == ["--feed-override"]:
        FeedOverride.serve()
    else:
        main()
