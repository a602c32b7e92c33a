"""A server of its own on a free port, by itself or under strace, and requests to it."""

import http.client
import json
import os
import re
import subprocess
import threading
import time

from system_calls import TRACED

# Of a start on a busy computer, under strace and with a debug binary.
PATIENCE_S = 60


class DoesNotStart(Exception):
    """With what the server said."""


class Connection:
    """Sends requests over one connection, as a machine does."""

    def __init__(self, port, token=None):
        self.connection = http.client.HTTPConnection("127.0.0.1", port, timeout=PATIENCE_S)
        self.token = token

    def send(self, method, path, body=None, headers=None):
        """Status, headers and body: JSON where it is some, text otherwise. Raises OSError or HTTPException without an answer."""
        headers = dict(headers or {})
        if self.token:
            headers["Authorization"] = f"Bearer {self.token}"
        if body is not None and not isinstance(body, str):
            headers.setdefault("Content-Type", "application/json")
            body = json.dumps(body)
        self.connection.request(method, path, body, headers)
        answer = self.connection.getresponse()
        text = answer.read().decode()
        if answer.headers.get_content_type() in ("application/json", "application/problem+json"):
            return answer.status, answer.headers, json.loads(text)
        return answer.status, answer.headers, text


class Service:
    """A server whose data directory and first token are in `folder`/disk, and its log beside that."""

    running = set()

    def __init__(self, binary, folder, trace=None, group_size=256, refused_sync=None):
        """With `trace` its system calls go there; with `refused_sync` that sync of that file fails, counted from 1, and its syncs are told there."""
        self.disk, self.log = os.path.join(folder, "disk"), os.path.join(folder, "server.log")
        self.token_file = os.path.join(self.disk, "first-token")
        self.traced = trace is not None or refused_sync is not None
        before = os.path.getsize(self.log) if os.path.exists(self.log) else 0
        command = [
            *(["strace", "-f", "-y", "-xx", "-s", str(1 << 24), "-e", f"trace={','.join(TRACED)}", "-o", trace] if trace else []),
            *(["strace", "-f", "-qq", "-o", refused_sync[2], "-P", refused_sync[0], "-e", "trace=fsync,fdatasync",
               "-e", f"inject=fsync,fdatasync:error=EIO:when={refused_sync[1]}"] if refused_sync else []),
            binary, "--data-dir", os.path.join(self.disk, "data"), "serve", "--listen", "127.0.0.1:0",
            "--first-token-file", self.token_file, "--set", f"limits.group_size={group_size}",
        ]
        with open(self.log, "ab") as log:
            self.process = subprocess.Popen(command, stdout=log, stderr=log)
        Service.running.add(self)
        try:
            self.port = self.wait_until_ready(before)
        except BaseException:
            self.kill()
            raise

    def wait_until_ready(self, before):
        port, end = None, time.monotonic() + PATIENCE_S
        while time.monotonic() < end:
            said = self.said(before)
            if self.process.poll() is not None:
                raise DoesNotStart(said[-1000:])
            if listening := re.search(r"listening address=127\.0\.0\.1:(\d+)", said):
                port = int(listening.group(1))
                try:
                    if Connection(port).send("GET", "/readyz")[0] == 200:
                        return port
                except (OSError, http.client.HTTPException):
                    pass
            time.sleep(0.01)
        raise DoesNotStart(f"not ready after {PATIENCE_S} s: {self.said(before)[-1000:]}")

    def said(self, before=0):
        with open(self.log, "rb") as log:
            log.seek(before)
            return re.sub(r"\x1b\[[0-9;]*m", "", log.read().decode(errors="replace"))

    def first_token(self):
        with open(self.token_file, encoding="ascii") as file:
            return file.read().strip()

    def server_pids(self):
        """Those of the server itself, where strace stands before it."""
        if not self.traced:
            return [self.process.pid]
        try:
            with open(f"/proc/{self.process.pid}/task/{self.process.pid}/children", encoding="ascii") as children:
                return [int(pid) for pid in children.read().split()]
        except FileNotFoundError:
            return []

    def kill(self):
        """Ends it at once. strace goes after it, with all that it has to tell."""
        for pid in self.server_pids():
            try:
                os.kill(pid, 9)
            except ProcessLookupError:
                pass
        try:
            self.process.wait(PATIENCE_S)
        except subprocess.TimeoutExpired:
            self.process.kill()
            self.process.wait()
        Service.running.discard(self)

    def stop(self):
        """Has it stop by itself; its exit status."""
        for pid in self.server_pids():
            os.kill(pid, 15)
        try:
            status = self.process.wait(PATIENCE_S)
        except subprocess.TimeoutExpired:
            self.kill()
            return "none: it does not stop"
        Service.running.discard(self)
        return status


def kill_all():
    for service in list(Service.running):
        service.kill()


def together(*tasks):
    """Runs all of these at once; what fails in one of them fails here."""
    failed = []

    def run(task):
        try:
            task()
        except BaseException as error:
            failed.append(error)

    threads = [threading.Thread(target=run, args=(task,)) for task in tasks]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    if failed:
        raise failed[0]
