"""What a server makes of a disk on which the power was lost, held against what was acknowledged before."""

import http.client
import os
import random
import sqlite3
import subprocess
import time
from contextlib import closing
from dataclasses import dataclass

from service import PATIENCE_S, Connection, DoesNotStart, Service

# Of one disk, over HTTP; the hashes of all of them are compared.
READ_AGAIN = 3
SENT_AGAIN = 8


@dataclass
class History:
    """What happened before and after a loss: all exchanges with their moments, and the content hashes of the cycles that were sent."""

    exchanges: list
    hashes: dict
    token: str

    def before(self, moment):
        """What was answered before it."""
        return [exchange for exchange in self.exchanges if exchange.moment is not None and exchange.moment < moment]

    def unacknowledged(self, moment):
        """Cycles that machines had sent by then or sent next, and were not told of, by machine and id; in the order of sending."""
        known = {(exchange.machine, cycle["cycle_id"]) for exchange in self.before(moment) for cycle in exchange.acknowledged_cycles()}
        found = {}
        for exchange in self.exchanges:
            for cycle in exchange.cycles():
                key = exchange.machine, cycle["cycle_id"]
                if key in self.hashes and key not in known:
                    found.setdefault(key, cycle)
        return found


def database(disk):
    path = os.path.join(disk, "data", "feedwright.sqlite3")
    return closing(sqlite3.connect(f"file:{path}?mode=ro", uri=True, timeout=PATIENCE_S))


def content_hashes(disk):
    with database(disk) as file:
        return {(machine, cycle): hash_ for machine, cycle, hash_ in file.execute("SELECT machine_id, cycle_id, content_hash FROM cycles")}


def samples_differ(connection, machine, cycle):
    """What is wrong with the samples that a server tells of a cycle, or nothing."""
    path = f"/v1/machines/{machine}/cycles/{cycle['cycle_id']}/samples"
    status, _, told = connection.send("GET", path, headers={"Accept": "application/json"})
    if status != 200:
        return f"samples of {machine}/{cycle['cycle_id']}: {status} {told}"
    differ = [name for name, values in cycle["samples"].items() if told.get(name) != values]
    return f"samples of {machine}/{cycle['cycle_id']} differ: {', '.join(differ)}" if differ else None


def judge(binary, folder, history, moment, seed):
    """Starts a server on `folder`/disk as it was started before, and returns all that is wrong."""
    chance = random.Random(seed)
    disk = os.path.join(folder, "disk")
    before = history.before(moment)
    known = [(exchange.machine, cycle) for exchange in before for cycle in exchange.acknowledged_cycles()]
    faults = []
    if os.path.exists(os.path.join(disk, "data")):
        # SQLite's index of its log is memory that happens to be a file: anything may be left of it.
        with open(os.path.join(disk, "data", "feedwright.sqlite3-shm"), "wb") as index:
            index.write(chance.randbytes(chance.choice((0, 32768))))
        if known and chance.random() < 0.25:
            # Whatever opens the database first takes up what the journal holds.
            faults += check(binary, disk)
    try:
        service = Service(binary, folder)
    except DoesNotStart as error:
        return [*faults, f"the server does not start: {error}"]
    again = []
    try:
        if before:
            faults += ask(service, history, before, known, chance)
        if any(exchange.id == "bush" for exchange in before):
            again, more = send_again(service, history, moment)
            faults += more
        if before:
            faults += folds_stay_behind(disk)
        if (status := service.stop()) != 0:
            faults.append(f"the server's exit status is {status}: {service.said()[-1000:]}")
    except (OSError, http.client.HTTPException, sqlite3.Error) as error:
        faults.append(f"the server, or its database, does not answer: {error!r}")
    finally:
        if service in Service.running:
            service.kill()
    try:
        return faults + check(binary, disk) + compare(disk, history, before, known + again)
    except sqlite3.Error as error:
        return [*faults, f"the database cannot be read: {error!r}"]


def check(binary, disk):
    """`feedwright check`: every block against its hash, summaries, wear against its fold, SQLite's own view of the file."""
    command = [binary, "--data-dir", os.path.join(disk, "data"), "check"]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    return [f"feedwright check: {(done.stdout + done.stderr)[-1000:]}"] if done.returncode else []


def ask(service, history, before, known, chance):
    """What only a server tells: tokens, sessions and samples."""
    faults = []
    if not os.path.exists(service.token_file) or service.first_token() != history.token:
        faults.append("the first token is lost, and was used")
    connection = Connection(service.port, history.token)
    status, _, told = connection.send("GET", "/v1/session")
    if status != 200:
        return [*faults, f"the token is not taken: {status} {told}"]
    for exchange in before:
        if exchange.kind == "session":
            # The cookie's name ends with the port of the server.
            secret = exchange.headers["Set-Cookie"].split(";")[0].split("=")[1]
            cookie = {"Cookie": f"feedwright_session_{service.port}={secret}"}
            if (status := Connection(service.port).send("GET", "/v1/session", headers=cookie)[0]) != 200:
                faults.append(f"a session is lost: {status}")
    for machine, cycle in chance.sample(known, min(READ_AGAIN, len(known))):
        if fault := samples_differ(connection, machine, cycle):
            faults.append(fault)
        status, _, told = connection.send("POST", f"/v1/machines/{machine}/cycles", cycle)
        if status != 200:
            faults.append(f"{machine}/{cycle['cycle_id']} was acknowledged, and is not known: {status} {told}")
    return faults


def send_again(service, history, moment):
    """What was under way is sent again: stored, or known where it had been committed."""
    connection, sent, faults = Connection(service.port, history.token), [], []
    for (machine, _), cycle in list(history.unacknowledged(moment).items())[:SENT_AGAIN]:
        status, _, told = connection.send("POST", f"/v1/machines/{machine}/cycles", cycle)
        if status not in (200, 201):
            faults.append(f"{machine}/{cycle['cycle_id']}, sent again: {status} {told}")
        sent.append((machine, cycle))
    return sent, faults


def folds_stay_behind(disk):
    """A server that has taken up a journal folds its tools' wear again beside its work."""
    end = time.monotonic() + PATIENCE_S
    with database(disk) as file:
        while behind := file.execute("SELECT count(*) FROM tool_wear WHERE fold_version = 0").fetchone()[0]:
            if time.monotonic() > end:
                return [f"{behind} folds stay behind"]
            time.sleep(0.02)
    return []


def compare(disk, history, before, cycles):
    """The rows that are there, against the exchanges before the loss and all `cycles` that were acknowledged before it or since."""
    if not os.path.exists(os.path.join(disk, "data", "feedwright.sqlite3")):
        return ["there is no database"]
    faults = []
    with database(disk) as file:
        def column(query):
            return {row[0] for row in file.execute(query)}

        stored = content_hashes(disk)
        for machine, cycle in cycles:
            if (machine, cycle["cycle_id"]) not in stored:
                faults.append(f"{machine}/{cycle['cycle_id']} is lost")
        for key, hash_ in stored.items():
            if key not in history.hashes:
                faults.append(f"{'/'.join(key)} was never sent")
            elif hash_ != history.hashes[key]:
                faults.append(f"{'/'.join(key)} is another one")
        samples = set(file.execute("SELECT machine_id, cycle_id FROM cycle_samples"))
        faults += [f"{'/'.join(key)} has no samples" for key in stored.keys() - samples]
        faults += [f"samples of {'/'.join(key)}, which is not there" for key in samples - stored.keys()]
        counted = dict(file.execute("SELECT tool_id, sum(folded) FROM tool_wear GROUP BY tool_id"))
        there = dict(file.execute("SELECT tool_id, count(*) FROM cycles GROUP BY tool_id"))
        faults += [
            f"wear of {tool} counts {counted.get(tool, 0)} cycles of {there.get(tool, 0)}"
            for tool in sorted(counted.keys() | there.keys()) if counted.get(tool, 0) != there.get(tool, 0)
        ]
        names = {
            kind: dict(file.execute(f"SELECT {kind}_id, name FROM {kind}s")) for kind in ("machine", "tool", "operation")
        }
        latest = {}
        for exchange in before:
            if exchange.kind in names and exchange.status in (200, 201):
                latest[exchange.kind, exchange.id] = exchange
        for (kind, id_), exchange in latest.items():
            sent = [later for later in history.exchanges if (later.kind, later.id) == (kind, id_)]
            allowed = [later.told["name"] for later in sent[sent.index(exchange) :]]
            if (name := names[kind].get(id_)) not in allowed:
                faults.append(f"{kind} {id_} is {name}, and none of {allowed}")
        ids = {
            "token": column("SELECT token_id FROM tokens"),
            "event": column("SELECT event_id FROM tool_events"),
        }
        recommendations = {bytes(id_)[:16] for id_ in column("SELECT recommendation_id FROM recommendations")}
        quarantine = column("SELECT quarantine_id FROM quarantine")
        for exchange in before:
            if exchange.kind in ids and exchange.answer["id"] not in ids[exchange.kind]:
                faults.append(f"{exchange.kind} {exchange.answer['id']} is lost")
            if (id_ := exchange.quarantined()) and id_ not in quarantine:
                faults.append(f"{id_} is lost from quarantine")
            if exchange.kind == "cycle" and exchange.status == 201:
                recommendation = exchange.answer["recommendation"]["id"]
                if bytes.fromhex(recommendation.replace("-", "")[:32]) not in recommendations:
                    faults.append(f"recommendation {recommendation} is lost")
        faults += [f"a row that refers to nothing: {row}" for row in file.execute("PRAGMA foreign_key_check")]
    return faults
