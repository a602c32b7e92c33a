"""Losses of power, simulated: a load is recorded under strace, and at many of its moments a server is started on what a disk may hold then.

Everything that was acknowledged before the moment has to be there, unaltered and counted once; what was not is there as a whole or not at
all, and can be sent again. What a disk may hold is in disk.py, what is looked at in judge.py, the load in load.py. Some of the moments are
followed by a second loss, while the next server starts on what the first one left, or soon after.

That this finds losses is tried first, each time: with the syncs of the journal, of SQLite's log or of the database ignored it has to.

The seed gives the load, the moments and what is kept. Threads do not come after each other twice in the same way, so that the same seed does
not make the same disk again: a disk on which something is wrong is kept.
"""

import argparse
import collections
import concurrent.futures
import os
import random
import shutil
import signal
import sqlite3
import subprocess
import sys
import tempfile
import time
from contextlib import closing
from dataclasses import replace

import disk
import failing_disk
import load
import moments
from judge import History, compare, content_hashes, judge, samples_differ
from service import Connection, DoesNotStart, Service, kill_all, together
from system_calls import Recording

# Files whose syncs are ignored for once, by the ends of their names, and what has to be found then. A server does not start on a journal that
# is ahead of its database, nor on a log without one.
CONTROLS = {"-groups": ("is lost",), "-wal": ("is lost", "does not start"), ".sqlite3": ("is lost", "does not start")}
# What is done to a database that is whole, and what has to be found then.
DAMAGES = {
    "DELETE FROM cycles WHERE cycle_id = 'c00004' AND machine_id = 'M1'": "M1/c00004 is lost",
    "UPDATE cycles SET cycle_id = 'c99999' WHERE cycle_id = 'c00004' AND machine_id = 'M1'": "M1/c99999 was never sent",
    "UPDATE cycles SET content_hash = zeroblob(32) WHERE cycle_id = 'c00004' AND machine_id = 'M1'": "M1/c00004 is another one",
    "DELETE FROM cycle_samples WHERE cycle_id = 'c00004' AND machine_id = 'M1'": "M1/c00004 has no samples",
    "UPDATE tool_wear SET folded = folded + 1 WHERE tool_id = 'T3'": "wear of T3 counts",
    "UPDATE machines SET name = 'other' WHERE machine_id = 'M3'": "machine M3 is other",
    "DELETE FROM quarantine": "is lost from quarantine",
    "DELETE FROM tool_events": "event 1 is lost",
    "DELETE FROM tokens": "token",
    "DELETE FROM recommendations": "recommendation",
}
# Each loss has three moments of the next start.
SECOND_LOSSES = 3
# Acknowledgements at which a control may find its loss.
CONTROL_MOMENTS = 8
# What the recorded servers are sent, and how many cycles a group of theirs may have. Where it is one, groups follow each other also under
# strace, where few machines wait at the same time: they share transactions, and the journal has records.
RUNS = ((load.first_run, 1), (load.killed_run, 2), (load.last_run, 256))


class DoesNotRecover(Exception):
    """A server does not take up its work on what a loss has left."""


class Story:
    def __init__(self, binary, folder, seed):
        self.binary, self.folder, self.seed = binary, folder, seed
        self.chance = random.Random(seed)
        # How often each sort of moment was tried, and each kind of loss.
        self.sorts_tried, self.losses_tried = collections.Counter(), collections.Counter()
        self.failed, self.deck = 0, []

    # --- the recording -------------------------------------------------------------------------------------------

    def record(self):
        """Three servers after each other on one folder: the first stops by itself, the second is killed, the third stops."""
        begun = time.monotonic()
        folder = os.path.join(self.folder, "recorded")
        os.makedirs(os.path.join(folder, "disk"))
        self.recording, sent = Recording(os.path.join(folder, "disk")), load.Load(self.seed)
        for number, (run, group_size) in enumerate(RUNS):
            trace = os.path.join(folder, f"trace{number}")
            service = Service(self.binary, folder, trace, group_size)
            sent.to(service)
            if run is load.killed_run:
                run(sent, service.kill)
            else:
                run(sent)
            if run is load.last_run:
                self.hold_against_what_was_sent(service, sent)
            if run is not load.killed_run and service.stop() != 0:
                raise SystemExit(f"the server that was recorded failed: {service.said()[-1000:]}")
            self.recording.read(trace, disk.read(service.disk))
            os.remove(trace)
        exchanges = load.at_moments(sent.exchanges, self.recording.answers)
        self.history = History(exchanges, content_hashes(service.disk), sent.token)
        self.sorts = moments.by_sort(self.recording, exchanges)
        self.hold_recording()
        print(f"recorded in {time.monotonic() - begun:.0f} s: {len(self.history.hashes)} cycles in {len(exchanges)} requests, "
              f"{len(self.recording.operations)} operations on files, {self.recording.lines} system calls")

    def hold_against_what_was_sent(self, service, sent):
        """From here on the content hash of a cycle stands for what was sent of it."""
        connection = Connection(service.port, sent.token)
        acknowledged = {
            (exchange.machine, cycle["cycle_id"]): cycle for exchange in sent.exchanges for cycle in exchange.acknowledged_cycles()
        }
        for (machine, _), cycle in acknowledged.items():
            if fault := samples_differ(connection, machine, cycle):
                raise SystemExit(f"without any loss of power: {fault}")

    def hold_recording(self):
        """A recording of which nothing is seen would find nothing, without a word."""
        for exchange in self.history.exchanges:
            expected = (200, 201, 409, 422) if exchange.kind == "cycle" else (200, 201)
            if exchange.status is not None and exchange.status not in expected:
                raise SystemExit(f"{exchange.kind} {exchange.id} was answered {exchange.status}: {exchange.answer}")
            if exchange.status is not None and exchange.moment is None:
                raise SystemExit(f"the answer to {exchange.kind} {exchange.id} is not among the system calls")
        wanted = {
            "the server was killed amid posts": any(exchange.status is None for exchange in self.history.exchanges),
            "cycles went to quarantine": any(exchange.quarantined() for exchange in self.history.exchanges),
            "cycles were known": any(exchange.kind == "cycle" and exchange.status == 200 for exchange in self.history.exchanges),
            **{f"there are moments of “{sort}”": lines for sort, lines in self.sorts.items()},
        }
        if lacking := [what for what, found in wanted.items() if not found]:
            raise SystemExit(f"the recording is not what it should be; not true: {', '.join(lacking)}")

    # --- disks ---------------------------------------------------------------------------------------------------

    def lost(self, name, left, history, moment, seed):
        """Judges one disk in a folder of its own; its faults."""
        folder = os.path.join(self.folder, name)
        os.makedirs(os.path.join(folder, "disk"))
        disk.write(left, os.path.join(folder, "disk"))
        faults = judge(self.binary, folder, history, moment, seed)
        shutil.rmtree(folder)
        return faults

    def keep(self, name, what, left, faults):
        """What is wrong, for who has to look at it: the disk as it was before the server began."""
        self.failed += 1
        folder = os.path.join(self.folder, f"{name}-failed")
        os.makedirs(os.path.join(folder, "disk"))
        disk.write(left, os.path.join(folder, "disk"))
        with open(os.path.join(folder, "faults"), "w", encoding="utf-8") as file:
            file.write("\n".join([what, *faults, ""]))
        print(f"FAILED: {what}; the disk is in {folder}/disk")
        for fault in faults[:5]:
            print(f"    {fault}")

    def control(self, ignored, expected):
        """As if a server never synced this file: at some acknowledgement something has to be found."""
        faulty = disk.Disk(self.recording, ignored)
        for number, line in enumerate(self.resting_on(ignored)):
            faulty.go_to(line)
            faults = self.lost(f"control{number}", faulty.after("none kept", self.chance), self.history, line, self.chance.random())
            if found := [fault for fault in faults for words in expected if words in fault]:
                print(f"control: without syncs of {ignored}: {found[0].splitlines()[0]:.60}")
                return
        raise SystemExit(f"where syncs of {ignored} are ignored nothing {' or '.join(expected)}: this test holds nothing")

    def damage(self):
        """As if the last server had left something else than what it was sent: it has to be seen."""
        whole = os.path.join(self.folder, "recorded", "disk")
        folder = os.path.join(self.folder, "damaged")
        exchanges = self.history.before(self.recording.lines)
        cycles = [(exchange.machine, cycle) for exchange in exchanges for cycle in exchange.acknowledged_cycles()]
        if faults := compare(whole, self.history, exchanges, cycles):
            raise SystemExit(f"without any loss of power: {faults[0]}")
        for statement, expected in DAMAGES.items():
            shutil.copytree(whole, folder)
            with closing(sqlite3.connect(os.path.join(folder, "data", "feedwright.sqlite3"))) as database, database:
                database.execute(statement)
            faults = compare(folder, self.history, exchanges, cycles)
            if not any(expected in fault for fault in faults):
                raise SystemExit(f"“{statement}” is not seen: this test holds nothing")
            shutil.rmtree(folder)
        print(f"control: {len(DAMAGES)} damages to the database are seen")

    def failing_disk(self):
        folder = os.path.join(self.folder, "failing-disk")
        os.makedirs(os.path.join(folder, "disk"))
        if faults := failing_disk.hold(self.binary, folder, self.seed):
            self.failed += 1
            print(f"FAILED: a sync of the database fails; what is left is in {folder}")
            for fault in faults[:5]:
                print(f"    {fault}")
            return
        print("a server whose database cannot be synced ends, and has lost nothing")
        shutil.rmtree(folder)

    def resting_on(self, ignored):
        """Acknowledgements of cycles that rest on this file: behind the most of its syncs without another file's in between, or late ones."""
        syncs = sorted((operation.ended, operation.path) for operation in self.recording.operations if operation.kind == "sync")
        in_a_row = {}
        for line in self.sorts["a cycle is acknowledged"]:
            latest = [path.endswith(ignored) for ended, path in reversed(syncs) if ended < line]
            in_a_row[line] = [*latest, False].index(False)
        return sorted(sorted(in_a_row, key=lambda line: (in_a_row[line], line))[-CONTROL_MOMENTS:])

    def losses(self, count):
        """One loss each: what to call it, its sort and its kind, what is left, and what that is held against."""
        kept = disk.Disk(self.recording)
        for line, sort in moments.drawn(self.sorts, count, self.chance):
            loss = self.loss()
            kept.go_to(line)
            yield f"{sort}, {loss} (line {line})", sort, loss, kept.after(loss, self.chance), self.history, line

    def loss(self):
        """Each as often as the others, in no order."""
        if not self.deck:
            self.deck = self.chance.sample(list(disk.LOSSES), len(disk.LOSSES))
        return self.deck.pop()

    def second_losses(self, count):
        """Two losses each, as `losses`: the second while a server takes up what the first has left, or after its first acknowledgements."""
        sorts = {sort: lines for sort, lines in self.sorts.items() if sort != "the first start"}
        registered = max(exchange.moment for exchange in self.history.exchanges if exchange.id == "bush")
        later = {sort: {line for line in lines if line > registered} for sort, lines in sorts.items()}
        kept = disk.Disk(self.recording)
        for number, (line, sort) in enumerate(moments.drawn(later, count // SECOND_LOSSES, self.chance)):
            loss = self.loss()
            kept.go_to(line)
            left, name = kept.after(loss, self.chance), f"recovery{number}"
            try:
                recording, history, early, answers = self.recover(name, left, line)
            except DoesNotRecover as error:
                self.keep(name, f"{sort}, {loss} (line {line})", left, [str(error)])
                continue
            chosen = moments.drawn({"early": early, "answered": answers}, SECOND_LOSSES, self.chance)
            again = disk.Disk(recording)
            for second, _ in chosen:
                again_lost = self.loss()
                again.go_to(second)
                what = f"{sort}, {loss} (line {line}), and again, {again_lost} (line {second} of the next start)"
                yield what, "a second loss", again_lost, again.after(again_lost, self.chance), history, second

    def recover(self, name, left, line):
        """Records a server that starts on what is left and is sent what was not acknowledged, until it is killed."""
        folder = os.path.join(self.folder, name)
        os.makedirs(os.path.join(folder, "disk"))
        disk.write(left, os.path.join(folder, "disk"))
        trace = os.path.join(folder, "trace")
        try:
            service = Service(self.binary, folder, trace, group_size=1)
        except DoesNotStart as error:
            raise DoesNotRecover(f"the server does not start: {error}") from error
        sent = load.Load(self.seed)
        sent.token = self.history.token
        sent.to(service)
        again = list(self.history.unacknowledged(line).items())[:9]
        together(*(lambda part=part: [sent.post(key[0], cycle) for key, cycle in part] for part in (again[0::3], again[1::3], again[2::3])))
        service.kill()
        for exchange in sent.exchanges:
            if exchange.status not in (200, 201):
                raise DoesNotRecover(f"{exchange.machine}/{exchange.id}, sent again: {exchange.status} {exchange.answer}")
        recording = Recording(service.disk, left)
        recording.read(trace, disk.read(service.disk))
        shutil.rmtree(folder)
        # What was acknowledged before the first loss stays so; what came after it never was.
        known = {exchange.request for exchange in self.history.before(line)}
        earlier = [replace(exchange, moment=-1) for exchange in self.history.exchanges if exchange.request in known]
        never = [replace(exchange, moment=None) for exchange in self.history.exchanges if exchange.request not in known]
        since = load.at_moments(sent.exchanges, recording.answers)
        answers = {exchange.moment + 1 for exchange in since if exchange.acknowledged_cycles()}
        early = {operation.begun + 1 for operation in recording.operations if operation.begun < min(answers, default=recording.lines)}
        return recording, History([*earlier, *since, *never], self.history.hashes, self.history.token), early, answers

    def run(self, count):
        self.failing_disk()
        self.record()
        self.damage()
        for ignored, expected in CONTROLS.items():
            self.control(ignored, expected)
        begun, second = time.monotonic(), count // 4 // SECOND_LOSSES * SECOND_LOSSES
        # As many servers at once as there are processors; disks are made as they are needed, as each is some megabytes.
        workers = os.cpu_count() or 1
        with concurrent.futures.ThreadPoolExecutor(workers) as pool:
            running = {}
            for source in (self.losses(count - second), self.second_losses(second)):
                for what, sort, loss, left, history, line in source:
                    self.sorts_tried[sort] += 1
                    self.losses_tried[loss] += 1
                    name = f"loss{self.sorts_tried.total()}"
                    running[pool.submit(self.lost, name, left, history, line, self.chance.random())] = name, what, left
                    while len(running) > workers:
                        self.collect(running)
            while running:
                self.collect(running)
        print(f"{self.sorts_tried.total()} losses of power in {time.monotonic() - begun:.0f} s")
        for tried in (self.sorts_tried, self.losses_tried):
            print("   ", ", ".join(f"{name} {times}" for name, times in sorted(tried.items())))

    def collect(self, running):
        done, _ = concurrent.futures.wait(running, return_when=concurrent.futures.FIRST_COMPLETED)
        for one in done:
            name, what, left = running.pop(one)
            if faults := one.result():
                self.keep(name, what, left, faults)


def hold_tracing():
    """A test that cannot trace fails, as it would hold nothing."""
    probe = subprocess.run(["strace", "-f", "-o", "/dev/null", "true"], capture_output=True, text=True, check=False)
    if probe.returncode != 0:
        raise SystemExit(f"strace cannot trace here (a container needs the capability SYS_PTRACE): {probe.stderr.strip()}")


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0], prog="tests/power-loss/run")
    parser.add_argument("binary", help=argparse.SUPPRESS)
    parser.add_argument("--seed", type=int, default=1, help="another load, other moments and losses (%(default)s)")
    parser.add_argument("--moments", type=int, default=96, help="so many losses, a quarter of them second ones (%(default)s)")
    arguments = parser.parse_args()
    # Told to stop, it ends its servers, and leaves nothing.
    signal.signal(signal.SIGTERM, signal.default_int_handler)
    hold_tracing()
    # Who watches it through a pipe sees how far it is.
    sys.stdout.reconfigure(line_buffering=True)
    begun = time.monotonic()
    print(f"seed {arguments.seed}")
    folder = os.path.realpath(tempfile.mkdtemp(prefix="feedwright-power-loss."))
    story, kept = Story(os.path.abspath(arguments.binary), folder, arguments.seed), True
    try:
        story.run(arguments.moments)
        kept = story.failed > 0
    except KeyboardInterrupt:
        kept = False
        raise SystemExit("told to stop") from None
    finally:
        kill_all()
        if kept:
            print(f"kept: {folder}")
        else:
            shutil.rmtree(folder, ignore_errors=True)
    if story.failed:
        sys.exit(f"after {story.failed} of these losses something is wrong")
    print(f"nothing that was acknowledged is lost ({time.monotonic() - begun:.0f} s)")


if __name__ == "__main__":
    main()
