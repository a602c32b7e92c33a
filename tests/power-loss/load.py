"""What machines and people send to a server, with what they were answered."""

import http.client
import json
import random
import threading
import time
import uuid
from dataclasses import dataclass, field, replace

from service import Connection, together

MACHINES = [f"M{number}" for number in range(1, 7)]
# A group that follows another within 50 ms shares its transaction (docs/store.md); one after this pause is committed by itself.
APART_S = 0.08


@dataclass
class Exchange:
    """A request and its answer. `kind` is cycle, batch, machine, tool, operation, token, session or event."""

    kind: str
    id: str
    told: object
    machine: str = ""
    request: str = field(default_factory=lambda: uuid.uuid4().hex)
    status: int | None = None
    headers: object = None
    answer: object = None
    # When the answer went out, as a line of the recording.
    moment: int | None = None

    def cycles(self):
        """Those that it carries, whether they were stored or not."""
        return {"cycle": [self.told], "batch": self.told}.get(self.kind, [])

    def acknowledged_cycles(self):
        """Those that the machine may forget, as they are stored."""
        if self.kind == "batch" and self.status == 200:
            outcomes = [json.loads(line) for line in self.answer.splitlines()]
            return [cycle for cycle, outcome in zip(self.told, outcomes, strict=True) if outcome["outcome"] in ("stored", "known")]
        return self.cycles() if self.kind == "cycle" and self.status in (200, 201) else []

    def quarantined(self):
        """The id under which the server keeps what it does not take."""
        return self.answer.get("quarantine_id") if self.kind == "cycle" and self.status in (409, 422) else None


class Load:
    """The load of one recording. What is sent follows from the seed; how threads come after each other does not."""

    def __init__(self, seed):
        self.chance = random.Random(seed)
        self.exchanges = []
        self.counts = dict.fromkeys(MACHINES, 0)
        self.answered = threading.Condition()
        self.stored = 0
        self.versions = {}
        self.local = threading.local()
        self.port = self.token = None

    def to(self, service):
        """From now on everything goes to this server."""
        self.port = service.port
        self.token = self.token or service.first_token()
        self.local = threading.local()

    def send(self, exchange, method, path, body, **headers):
        """Notes the exchange. Where the server is gone, it stays without an answer."""
        self.exchanges.append(exchange)
        if not hasattr(self.local, "connection"):
            self.local.connection = Connection(self.port, self.token)
        headers = {name.replace("_", "-"): value for name, value in headers.items()} | {"x-request-id": exchange.request}
        try:
            exchange.status, exchange.headers, exchange.answer = self.local.connection.send(method, path, body, headers)
        except (OSError, http.client.HTTPException):
            del self.local.connection
        if exchange.acknowledged_cycles():
            with self.answered:
                self.stored += 1
                self.answered.notify_all()
        return exchange

    def cycle(self, machine, tool=None):
        """The next one of a machine: some seconds of drilling, sampled at 100 Hz."""
        self.counts[machine] += 1
        number, samples = self.counts[machine], self.chance.randint(80, 300)
        around = {"spindle_load_percent": 20, "feed_drive_load_percent": 12, "feed_actual_mm_min": 140, "torque_newton_metres": 6}
        channels = {name: [round(self.chance.gauss(mean, mean / 50), 2) for _ in range(samples)] for name, mean in around.items()}
        channels["depth_mm"] = [round(10 * sample / samples, 3) for sample in range(samples)]
        return {
            "cycle_id": f"c{number:05}", "tool": tool or machine.replace("M", "T"), "operation": "bush",
            "started_at": f"2026-05-04T{6 + number // 60:02}:{number % 60:02}:00Z", "samples": {"period_ms": 10, **channels},
        }

    def post(self, machine, cycle, **headers):
        return self.send(Exchange("cycle", cycle["cycle_id"], cycle, machine), "POST", f"/v1/machines/{machine}/cycles", cycle, **headers)

    def post_batch(self, machine, cycles):
        lines = "".join(json.dumps(cycle) + "\n" for cycle in cycles)
        batch = Exchange("batch", cycles[0]["cycle_id"], cycles, machine)
        return self.send(batch, "POST", f"/v1/machines/{machine}/cycles/batch", lines, Content_Type="application/x-ndjson")

    def post_again(self, exchange):
        """As a machine does that was not answered."""
        again = self.post_batch if exchange.kind == "batch" else self.post
        return again(exchange.machine, exchange.told)

    def register(self, kind, id_, **more):
        version = self.versions.get((kind, id_), 0)
        body = {"name": f"{kind} {id_}, version {version + 1}", **more}
        changed = {"If_Match": f'"{version}"'} if version else {}
        put = self.send(Exchange(kind, id_, body), "PUT", f"/v1/{kind}s/{id_}", body, **changed)
        if put.status in (200, 201):
            self.versions[kind, id_] = version + 1
        return put

    def register_machine(self, machine):
        return self.register(
            "machine", machine, control="sinumerik-840d", ipo_period_ms=10, feed_drive={"reference": "unknown"},
            spindle={"reference": "rated_power", "rated_power_watts": 7000},
            limits={"feed_min_mm_min": 1, "feed_max_mm_min": 5000, "override_min_percent": 5, "override_max_percent": 200})

    def register_tool(self, tool):
        return self.register("tool", tool, tool_type="fd-7.3")

    def register_operation(self, operation):
        return self.register("operation", operation, process="friction", programmed_feed_mm_min=140)

    def register_all(self):
        for machine in MACHINES:
            self.register_machine(machine)
            self.register_tool(machine.replace("M", "T"))
        self.register_operation("hole")
        self.register_operation("bush")

    def people(self):
        """A token, a session and a tool that was changed."""
        self.send(Exchange("token", "viewer", None), "POST", "/v1/tokens", {"name": "viewer", "role": "viewer"})
        self.send(Exchange("session", "page", None), "POST", "/v1/session", {"token": self.token}, x_feedwright_page="1")
        self.send(Exchange("event", "T2", None), "POST", "/v1/tools/T2/events", {"kind": "changed"})

    def singles(self, count):
        """One after the other: some by themselves, some right behind another."""
        for number in range(count):
            if number % 3 != 2:
                time.sleep(APART_S)
            self.post("M1", self.cycle("M1"), **({"Prefer": "return=minimal"} if number % 2 else {}))

    def burst(self, count, *beside):
        """All machines at once, so that groups follow each other and share transactions. Some run another machine's tool."""
        cycles = {
            machine: [self.cycle(machine, "T1" if number % 4 == 3 else None) for number in range(count)] for machine in MACHINES
        }

        def run(machine):
            for cycle in cycles[machine]:
                if self.post(machine, cycle).status is None:
                    return

        together(*(lambda machine=machine: run(machine) for machine in MACHINES), *beside)

    def refused(self):
        """Known cycles, one with another content, and one that no machine can have run."""
        stored = [exchange for exchange in self.exchanges if exchange.kind == "cycle" and exchange.status == 201]
        for exchange in self.chance.sample(stored, 3):
            self.post_again(exchange)
        other = self.cycle("M1") | {"cycle_id": stored[0].id}
        self.post(stored[0].machine, other)
        self.post("M2", {"cycle_id": "upside-down", "tool": "T2", "operation": "bush", "started_at": "2026-05-04T06:00:00Z",
                         "samples": {"period_ms": 10, "spindle_load_percent": [1e9]}})

    def unanswered(self):
        """What a machine has to send again."""
        known = {(exchange.machine, cycle["cycle_id"]) for exchange in self.exchanges for cycle in exchange.acknowledged_cycles()}
        return [
            exchange for exchange in self.exchanges
            if exchange.status is None and any((exchange.machine, cycle["cycle_id"]) not in known for cycle in exchange.cycles())
        ]

    def wait_for(self, count):
        """Until so many more posts are answered."""
        with self.answered:
            enough = self.stored + count
            if not self.answered.wait_for(lambda: self.stored >= enough, timeout=60):
                raise TimeoutError(f"not {count} posts were answered")


def first_run(load):
    """A new data directory; stopped by itself."""
    load.register_all()
    load.people()
    load.singles(9)
    office = [
        lambda: [load.register_machine("M3"), load.register_tool("T4"), load.people()],
        lambda: [load.post_batch("M5", [load.cycle("M5") for _ in range(8)]) for _ in range(3)],
    ]
    load.burst(8, *office)
    load.refused()
    load.singles(3)


def killed_run(load, kill):
    """Killed while all machines post."""
    load.singles(2)
    batches = [[load.cycle("M6") for _ in range(8)] for _ in range(12)]

    def post_batches():
        for batch in batches:
            if load.post_batch("M6", batch).status is None:
                return

    def kill_amid():
        load.wait_for(45)
        kill()

    load.burst(30, post_batches, kill_amid)


def last_run(load):
    """Machines send again what was not answered, and go on; stopped by itself."""
    for exchange in load.unanswered():
        load.post_again(exchange)
    load.burst(5, lambda: [load.register_machine("M5"), load.people()])
    load.singles(4)


def at_moments(exchanges, answers):
    """The exchanges, with the moments of their answers; some of them have had none."""
    return [replace(exchange, moment=answers.get(exchange.request)) for exchange in exchanges]
