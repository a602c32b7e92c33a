"""What servers did to their files, and when they answered, from the logs of strace.

A moment is the number of a line over all logs of a recording. A system call that takes a while begins at one line and ends at another;
strace sees a thread's call begin before, and end after, it takes effect, and no thread goes on before that is seen. So what stands behind
an answer's line was not done yet when the answer went out.
"""

import os
import re
from dataclasses import dataclass

WRITES = ("write", "writev", "pwrite64", "sendto", "sendmsg")
CHANGES = ("openat", "ftruncate", "unlink", "unlinkat", "rename", "renameat", "renameat2", "mkdir", "mkdirat")
SYNCS = ("fsync", "fdatasync")
# These change files in ways that the model does not have: where a server uses one of them on its files, the model has to learn it first.
UNKNOWN = ("creat", "pwritev", "pwritev2", "fallocate", "truncate", "copy_file_range", "sendfile", "link", "linkat", "symlink", "symlinkat",
           "rmdir", "sync_file_range", "msync", "syncfs", "sync", "io_uring_setup")
TRACED = WRITES + CHANGES + SYNCS + UNKNOWN

NEVER = 1 << 60
DIRECTORY = -1

CALL = re.compile(rb"^(\d+) +(\w+)\(")
HANDLE = re.compile(rb"(?:\d+|AT_FDCWD)<([^>]*)>")
STRING = re.compile(rb'"([^"]*)"(\.\.\.)?')


@dataclass(slots=True)
class Operation:
    """One of: write, truncate, sync (of a file), make, make_directory, remove, rename, sync_names (of a directory)."""

    kind: str
    path: str
    file: int = DIRECTORY
    offset: int = 0
    data: bytes = b""
    to: str = ""
    begun: int = 0
    ended: int = NEVER


class NotModelled(Exception):
    """A system call that this does not know, or a file that is not what the calls made of it."""


class Recording:
    """The operations of servers that ran one after the other on the folder `disk`. Paths are relative to it."""

    def __init__(self, disk, found=None):
        """`found` is what stood there, durable, before: contents by path, `None` for directories."""
        self.disk = os.fsencode(disk)
        self.found = found or {}
        self.operations, self.answers, self.starts, self.ends = [], {}, [], []
        self.lines, self.files = 0, 0
        # As running programs see it.
        self.names, self.contents = {}, {}
        for path, content in self.found.items():
            self.names[path] = DIRECTORY if content is None else self.new_file(content)
        self.first_names = dict(self.names)

    def new_file(self, content=b""):
        self.files += 1
        self.contents[self.files] = bytearray(content)
        return self.files

    def read(self, trace, now):
        """Goes on with the log of a server that has ended; `now` is what the folder held then, as `found`."""
        self.starts.append(self.lines)
        unfinished = {}
        with open(trace, "rb") as log:
            for line in log:
                self.lines += 1
                line = line.rstrip(b"\n")
                pid, _, rest = line.partition(b" ")
                rest = rest.lstrip()
                if rest.startswith(b"<... ") and pid in unfinished:
                    head, begun, operation = unfinished.pop(pid)
                    self.end(head + rest.split(b"resumed>", 1)[1], begun, operation)
                elif not CALL.match(line):
                    # A thread was created, ended, or was killed at the very begin of a call ("???("), which was not carried out then.
                    continue
                elif rest.endswith(b"<unfinished ...>"):
                    head = line[: -len(b"<unfinished ...>")]
                    unfinished[pid] = head, self.lines, self.begin(head)
                else:
                    self.end(line, self.lines, self.begin(line))
        self.ends.append(self.lines)
        self.settle(unfinished.values(), now)

    def settle(self, unfinished, now):
        """What was cut off by the end of its process went as far as `now` shows; everything else has to show there."""
        for operation in self.operations:
            if operation.kind == "write" and operation.ended == NEVER:
                there = now.get(operation.path) or b""
                operation.data = there[operation.offset : operation.offset + len(operation.data)]
                operation.ended = self.lines
                self.put(operation)
                del self.contents[operation.file][len(there) :]
        self.operations = [operation for operation in self.operations if operation.kind != "write" or operation.data]
        if self.seen() != now:
            for head, begun, _ in unfinished:
                name = CALL.match(head).group(2).decode()
                # A killed process may have left no text of a path that could be read.
                if name == "ftruncate" or name in CHANGES and STRING.search(head):
                    self.end(head + b") = 0", begun, None)
        seen = self.seen()
        for path in sorted(seen.keys() | now.keys()):
            if path not in seen or path not in now or seen[path] != now[path]:
                raise NotModelled(f"{path} is not what the system calls of the server made of it")

    def seen(self):
        """What running programs see, as `found`."""
        return {path: None if file == DIRECTORY else bytes(self.contents[file]) for path, file in self.names.items()}

    def inside(self, path):
        """The path below the folder, or `None` elsewhere. The index of SQLite's log is memory, whatever is kept of it."""
        path = bytes.fromhex(path.replace(b"\\x", b"").decode()) if path.startswith(b"\\x") else path
        if path == self.disk:
            return ""
        if not path.startswith(self.disk + b"/") or path.endswith((b"-shm", b" (deleted)", b"(deleted)")):
            return None
        return os.fsdecode(path[len(self.disk) + 1 :])

    def begin(self, head):
        """A write may reach the disk from its begin on, long before it returns."""
        name = CALL.match(head).group(2)
        if name.decode() in WRITES:
            handle = HANDLE.search(head)
            path = self.inside(handle.group(1)) if handle else None
            strings = list(STRING.finditer(head))
            if any(string.group(2) for string in strings):
                raise NotModelled("strace has cut off what was written")
            data = bytes.fromhex(b"".join(string.group(1) for string in strings).replace(b"\\x", b"").decode())
            if path is None:
                self.answer(data)
                return None
            if path not in self.names:
                return None
            # Without a place of its own a write goes to the end: such files are written from front to back.
            file = self.names[path]
            offset = len(self.contents[file])
            if name == b"pwrite64":
                offset = int(re.search(rb", (\d+)\)? *(=|$)", head[-80:]).group(1))
            operation = Operation("write", path, file, offset, data, begun=self.lines)
            self.operations.append(operation)
            self.put(operation)
            return operation
        return None

    def answer(self, data):
        """Notes when the answer to a request went out. An answer in pieces counts from its first one on, which is stricter."""
        if data.startswith(b"HTTP/1.1 "):
            named = re.search(rb"\r\nx-request-id: (\S+)\r\n", data)
            if named:
                self.answers[named.group(1).decode()] = self.lines

    def put(self, operation):
        """As running programs see it at once."""
        content, end = self.contents[operation.file], operation.offset + len(operation.data)
        if operation.kind == "truncate":
            del content[operation.offset :]
            content.extend(bytes(operation.offset - len(content)))
        else:
            content.extend(bytes(max(0, end - len(content))))
            content[operation.offset : end] = operation.data

    def end(self, call, begun, operation):
        name = CALL.match(call).group(2).decode()
        result = call.rsplit(b"= ", 1)[-1]
        if operation is not None:
            if not result.startswith(b"?"):
                operation.ended = self.lines
                if int(result.split()[0]) != len(operation.data):
                    raise NotModelled(f"a write to {operation.path} was not whole")
            return
        if result.startswith((b"-1", b"?")) or name in WRITES:
            return
        arguments = call[: call.rindex(b"= ")]
        handles = [self.inside(handle.group(1)) for handle in HANDLE.finditer(arguments)]
        strings = [self.inside(string.group(1)) for string in STRING.finditer(arguments)]

        def note(kind, path, **more):
            made = Operation(kind, path, begun=begun, ended=self.lines, **more)
            self.operations.append(made)
            return made

        if name == "openat":
            path = strings[0]
            if path is None or b"O_DIRECTORY" in arguments:
                return
            if b"O_CREAT" in arguments and path not in self.names:
                self.names[path] = self.new_file()
                note("make", path, file=self.names[path])
            elif b"O_TRUNC" in arguments:
                self.put(note("truncate", path, file=self.names[path]))
        elif name in SYNCS:
            path = handles[0]
            if path is None:
                return
            file = self.names.get(path, DIRECTORY)
            note("sync_names" if file == DIRECTORY else "sync", path, file=file)
        elif name == "ftruncate":
            path = handles[0]
            if path is not None:
                length = int(re.search(rb", (\d+) *\)", arguments).group(1))
                self.put(note("truncate", path, file=self.names[path], offset=length))
        elif name in ("unlink", "unlinkat"):
            if strings[0] is not None and strings[0] in self.names:
                note("remove", strings[0], file=self.names.pop(strings[0]))
        elif name in ("rename", "renameat", "renameat2"):
            source, target = strings
            if source is not None:
                self.names[target] = self.names.pop(source)
                note("rename", source, file=self.names[target], to=target)
        elif name in ("mkdir", "mkdirat"):
            if strings[0] is not None:
                self.names[strings[0]] = DIRECTORY
                note("make_directory", strings[0])
        elif name in UNKNOWN and (any(path is not None for path in handles + strings) or not handles + strings):
            raise NotModelled(f"the server calls {name}: {call[:200].decode(errors='replace')}")
