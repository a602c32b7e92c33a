"""What a disk may hold when the power is lost.

Certain is what was synced: bytes by a sync of their file that began after their write had ended, names (of files that were made, removed or
renamed) by a sync of their directory. Of everything else any part may be there, in any order, also of one write. Real disks and file systems
are kinder than that; none of them promises it.
"""

import os
from dataclasses import replace

from system_calls import DIRECTORY

SECTOR, PAGE = 512, 4096


def pieces(operation, size):
    """A write, cut at the multiples of `size` bytes of its file."""
    start, end = operation.offset, operation.offset + len(operation.data)
    while start < end:
        stop = min((start // size + 1) * size, end)
        yield replace(operation, offset=start, data=operation.data[start - operation.offset : stop - operation.offset])
        start = stop


def torn(size):
    def survive(pending, chance):
        return [
            [operation] * chance.randrange(2) if operation.kind == "truncate"
            else [piece for piece in pieces(operation, size) if chance.random() < 0.5]
            for operation in pending
        ]
    return survive


def prefix(pending, chance):
    whole = chance.randrange(len(pending))
    cut = list(pieces(pending[whole], SECTOR))
    return [[operation] for operation in pending[:whole]] + [cut[: chance.randint(0, len(cut))]]


def suffix(pending, chance):
    lost = chance.randrange(len(pending))
    return [[] for _ in pending[:lost]] + [[operation] for operation in pending[lost:]]


def some(pending, chance):
    share = chance.choice((0.1, 0.5, 0.9))
    return [[operation] if chance.random() < share else [] for operation in pending]


def lengths(pending, chance):
    """A file system has noted that a file is longer, and not written what is in it: zeros."""
    return [
        [operation] if chance.random() < 0.3
        else [replace(operation, offset=operation.offset + len(operation.data), data=b"")] * (operation.kind == "write")
        for operation in pending
    ]


# What survives of a file's writes and truncations that were not synced, in their order: for each of them what is left of it.
LOSSES = {
    "none kept": lambda pending, chance: [],
    "all kept": lambda pending, chance: [[operation] for operation in pending],
    "the first kept": prefix,
    "the later kept": suffix,
    "the last kept": lambda pending, chance: [[] for _ in pending[1:]] + [[pending[-1]]],
    "some kept": some,
    f"torn at {SECTOR} bytes": torn(SECTOR),
    f"torn at {PAGE} bytes": torn(PAGE),
    "lengths kept": lengths,
}


def apply(content, operation):
    if operation.kind == "truncate":
        del content[operation.offset :]
        content.extend(bytes(operation.offset - len(content)))
        return
    end = operation.offset + len(operation.data)
    content.extend(bytes(max(0, end - len(content))))
    content[operation.offset : end] = operation.data


def rename(names, operation):
    """Carries out what is done to names."""
    if operation.kind in ("make", "make_directory"):
        names[operation.path] = operation.file
    elif names.get(operation.path) == operation.file:
        del names[operation.path]
        if operation.kind == "rename":
            names[operation.to] = operation.file


class Unsure:
    """Operations that may be lost. Those that are synced behind one that is not have to wait for it, as they go in their order."""

    def __init__(self):
        self.waiting = []

    def add(self, operation):
        self.waiting.append([operation, False])

    def sync(self, covered):
        """Takes out what is certain from the front on."""
        for entry in self.waiting:
            entry[1] = entry[1] or covered(entry[0])
        certain = 0
        while certain < len(self.waiting) and self.waiting[certain][1]:
            certain += 1
        done, self.waiting = self.waiting[:certain], self.waiting[certain:]
        return [operation for operation, _ in done]

    def survivors(self, survive, chance):
        pending = [operation for operation, synced in self.waiting if not synced]
        left = iter(survive(pending, chance) if pending else [])
        return [piece for operation, synced in self.waiting for piece in ([operation] if synced else next(left, []))]


class Disk:
    """Goes forward over a recording. `ignored` is the end of a file's name whose syncs are taken for not having been there: a control."""

    def __init__(self, recording, ignored=None):
        self.ignored = ignored
        self.names, self.names_unsure = dict(recording.first_names), Unsure()
        self.contents = {
            file: bytearray(recording.found[path]) for path, file in recording.first_names.items() if file != DIRECTORY
        }
        self.unsure = {}
        syncs = ("sync", "sync_names")
        self.steps = sorted(
            ((operation.ended if operation.kind in syncs else operation.begun, operation) for operation in recording.operations),
            key=lambda step: step[0],
        )
        self.next = 0

    def go_to(self, moment):
        """Every write that had begun, and every sync that was over, before this line."""
        while self.next < len(self.steps) and self.steps[self.next][0] < moment:
            self.step(self.steps[self.next][1])
            self.next += 1

    def step(self, operation):
        if operation.kind in ("write", "truncate"):
            self.unsure.setdefault(operation.file, Unsure()).add(operation)
        elif operation.kind == "sync":
            if self.ignored and operation.path.endswith(self.ignored):
                return
            content = self.contents.setdefault(operation.file, bytearray())
            if operation.file in self.unsure:
                for certain in self.unsure[operation.file].sync(lambda earlier: earlier.ended <= operation.begun):
                    apply(content, certain)
        elif operation.kind == "sync_names":
            for certain in self.names_unsure.sync(
                lambda earlier: earlier.ended <= operation.begun and os.path.dirname(earlier.path) == operation.path
            ):
                rename(self.names, certain)
        else:
            self.names_unsure.add(operation)

    def after(self, loss, chance):
        """What is left: contents by path, `None` for directories."""
        names = dict(self.names)
        share = {"none kept": 0.0, "all kept": 1.0}.get(loss, 0.5)
        kept = self.names_unsure.survivors(
            lambda pending, chance: [[operation] * (chance.random() < share) for operation in pending], chance)
        for operation in kept:
            rename(names, operation)
        left = {}
        for path, file in sorted(names.items()):
            folder = os.path.dirname(path)
            if folder and folder not in left:
                continue
            if file == DIRECTORY:
                left[path] = None
                continue
            content = bytearray(self.contents.get(file, b""))
            if file in self.unsure:
                for operation in self.unsure[file].survivors(LOSSES[loss], chance):
                    apply(content, operation)
            left[path] = bytes(content)
        return left


def write(left, folder):
    for path, content in left.items():
        target = os.path.join(folder, path)
        if content is None:
            os.mkdir(target, 0o700)
        else:
            with open(target, "wb", opener=lambda name, flags: os.open(name, flags, 0o600)) as file:
                file.write(content)


def read(folder):
    """As `write` takes it. The index of SQLite's log is left out, as it is memory."""
    found = {}
    for place, folders, files in os.walk(folder):
        for name in folders:
            found[os.path.relpath(os.path.join(place, name), folder)] = None
        for name in files:
            if not name.endswith("-shm"):
                with open(os.path.join(place, name), "rb") as file:
                    found[os.path.relpath(os.path.join(place, name), folder)] = file.read()
    return found
