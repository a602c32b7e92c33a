"""Prometheus, Grafana's queries and Feedwright, together; see `watched`, which calls this."""
import base64
import csv
import io
import json
import math
import os
import pathlib
import re
import signal
import socket
import ssl
import struct
import subprocess
import sys
import tempfile
import time
import urllib.error
import urllib.parse
import urllib.request

import yaml

ROOT = pathlib.Path(__file__).resolve().parents[2]
FEEDWRIGHT, PROMETHEUS, NGINX, CADDY = sys.argv[1], pathlib.Path(sys.argv[2]), sys.argv[3], sys.argv[4]
POSTGRES = os.environ["FEEDWRIGHT_TEST_POSTGRES"]
# Firing without a waiting time, and each from another source: an alarm, the watch's round, a counter.
MUST_FIRE = {"FeedwrightToolWorn", "FeedwrightMachineSilent", "FeedwrightCyclesRejected",
             "FeedwrightCertificateExpiring"}
PATIENCE_S = 180
MACHINE = {"name": "Mill", "control": "sinumerik-840d", "ipo_period_ms": 10,
           "limits": {"feed_min_mm_min": 1, "feed_max_mm_min": 5000, "override_min_percent": 5,
                      "override_max_percent": 200},
           "spindle": {"reference": "unknown"}, "feed_drive": {"reference": "unknown"}}


def fail(why):
    sys.exit(f"FAILED: {why}")


def free_port():
    with socket.socket() as found:
        found.bind(("127.0.0.1", 0))
        return found.getsockname()[1]


def get(url, token=None):
    request = urllib.request.Request(url, headers={"Authorization": f"Bearer {token}"} if token else {})
    with urllib.request.urlopen(request, timeout=30) as answer:
        return answer.read().decode()


def send(method, url, token, body):
    headers = {"Authorization": f"Bearer {token}", "Content-Type": "application/json"}
    request = urllib.request.Request(url, json.dumps(body).encode(), headers, method=method)
    end = time.monotonic() + PATIENCE_S
    while True:
        try:
            with urllib.request.urlopen(request, timeout=60) as answer:
                return json.loads(answer.read())
        except urllib.error.HTTPError as error:
            # "Come again", as an adapter does on a busy machine.
            if error.code != 503 or time.monotonic() > end:
                fail(f"{method} {url}: {error.code} {error.read().decode()}")
            time.sleep(float(error.headers.get("Retry-After", 1)))


def wait(what, ready):
    end = time.monotonic() + PATIENCE_S
    while not ready():
        if time.monotonic() > end:
            fail(what())
        time.sleep(0.3)


class Server:
    """A Feedwright of its own."""

    def __init__(self, folder, name, database, **more):
        self.name, self.log = name, folder / f"{name}.log"
        self.address = f"127.0.0.1:{free_port()}"
        self.url = f"http://{self.address}"
        # Without a token, so that a Prometheus that has another server's can read it.
        self.metrics = f"127.0.0.1:{free_port()}"
        settings = {"METRICS__LISTEN": self.metrics,
                    "SERVER__LISTEN": self.address, "DATA_DIR": folder / name, "DATABASE__URL": database,
                    "WATCH__INTERVAL_MS": "500", "WATCH__MACHINE_SILENT_AFTER_MS": "3000", **more}
        self.environment = {**os.environ, **{f"FEEDWRIGHT__{key}": str(value) for key, value in settings.items()}}
        self.process = subprocess.Popen([FEEDWRIGHT, "serve"], stderr=open(self.log, "w"), env=self.environment)
        wait(lambda: f"{name} does not start: {self.log.read_text()}", lambda: "make others" in self.log.read_text())
        self.admin = re.search(r"fwt_\S+", self.log.read_text())[0]

    def viewer(self):
        return send("POST", f"{self.url}/v1/tokens", self.admin, {"name": "prometheus", "role": "viewer"})["token"]

    def machine_token(self, machine):
        body = {"name": machine, "role": "machine", "machine": machine}
        return send("POST", f"{self.url}/v1/tokens", self.admin, body)["token"]

    def register(self, trust):
        """A machine, over TLS."""
        headers = {"Authorization": f"Bearer {self.admin}", "Content-Type": "application/json"}
        request = urllib.request.Request(f"https://{self.address}/v1/machines/worn", json.dumps(MACHINE).encode(), headers,
                                         method="PUT")
        urllib.request.urlopen(request, timeout=30, context=trust).close()

    def back_up(self, file):
        """A backup while it is busy; what it says of the last one then follows."""
        ran = subprocess.run([FEEDWRIGHT, "backup", file], env=self.environment, text=True, capture_output=True, check=False)
        if ran.returncode or "does not remember" in ran.stderr:
            fail(f"backup of {self.name}: {ran.stdout}{ran.stderr}")

        def noted():
            at = re.search(r"^feedwright_last_backup_timestamp_seconds (\S+)$", get(f"http://{self.metrics}/metrics"), re.M)
            return time.time() - float(at[1]) < PATIENCE_S

        wait(lambda: f"the backup of {self.name} is not noted", noted)

    def simulate(self):
        return subprocess.Popen(
            [FEEDWRIGHT, "simulate", "--server", self.url, "--machines", "2", "--cycles", "70", "--life", "40",
             "--faults", "air_cut,broken_tool,thickness,nan_body,duplicate,late_replay", "--fault-share", "0.08"],
            env={**os.environ, "FEEDWRIGHT_TOKEN": self.admin}, stdout=subprocess.DEVNULL)

    def refuse(self):
        """An adapter that writes broken JSON: refused, and kept nowhere."""
        request = urllib.request.Request(
            f"{self.url}/v1/machines/worn/cycles", b'{"cycle_id": ', method="POST",
            headers={"Authorization": f"Bearer {self.admin}", "Content-Type": "application/json"})
        try:
            urllib.request.urlopen(request, timeout=30)
        except urllib.error.HTTPError as error:
            if error.code == 400:
                return
        fail("broken JSON is not refused")

    def wear_out(self):
        """A tool that wears steadily: near its end on one machine, worn and still in the spindle on another."""
        operation = {"name": "Bush", "process": "friction", "programmed_feed_mm_min": 140}
        send("PUT", f"{self.url}/v1/operations/bush", self.admin, operation)
        # Within an hour of now, so that every dashboard's range holds it.
        begin = time.time() - 1800
        for name, cycles in (("near-end", 40), ("worn", 80)):
            send("PUT", f"{self.url}/v1/machines/{name}", self.admin, MACHINE)
            send("PUT", f"{self.url}/v1/tools/tool-{name}", self.admin, {"name": "drill", "tool_type": "fd-7.3"})
            for number in range(cycles):
                at = time.strftime("%Y-%m-%dT%H:%M:%SZ", time.gmtime(begin + 10 * number))
                # Wear creeps: a twentieth of a percent at first, then a fifth a cycle.
                energy = 2000 * (1 + 0.002 * max(0, number - 10)) * (1 + 0.002 * math.sin(number))
                send("POST", f"{self.url}/v1/machines/{name}/cycles", self.admin, {
                    "cycle_id": f"c{number}", "tool": f"tool-{name}", "operation": "bush", "started_at": at,
                    "reported": {"energy_joules": energy, "duration_ms": 4280}})


def certificate(folder, days):
    """A self-signed certificate that ends in so many days, where the cell looks for it."""
    # A configuration of its own: Debian's makes every self-signed certificate an authority, which is no server's.
    (folder / "openssl.cnf").write_text("[req]\ndistinguished_name = dn\n[dn]\n")
    subprocess.run(["openssl", "req", "-config", folder / "openssl.cnf", "-x509", "-newkey", "ec", "-pkeyopt", "ec_paramgen_curve:prime256v1", "-nodes",
                    "-days", str(days), "-subj", "/CN=cell", "-addext", "subjectAltName=IP:127.0.0.1", "-keyout",
                    folder / "key.pem", "-out", folder / "chain.pem"], check=True, stderr=subprocess.DEVNULL)


class Stream:
    """A machine's WebSocket over TLS, as `docs/stream.md` has it, and no more of RFC 6455 than that needs."""

    def __init__(self, address, machine, token, trust):
        host, port = address.split(":")
        self.socket = trust.wrap_socket(socket.create_connection((host, int(port)), timeout=30), server_hostname=host)
        self.certificate = self.socket.getpeercert(binary_form=True)
        key = base64.b64encode(os.urandom(16)).decode()
        self.socket.sendall((
            f"GET /v1/machines/{machine}/stream HTTP/1.1\r\nHost: {address}\r\nUpgrade: websocket\r\n"
            f"Connection: Upgrade\r\nSec-WebSocket-Key: {key}\r\nSec-WebSocket-Version: 13\r\n"
            f"Sec-WebSocket-Protocol: feedwright.v1\r\nAuthorization: Bearer {token}\r\n\r\n").encode())
        self.file = self.socket.makefile("rb")
        head = []
        while line := self.file.readline().strip():
            head.append(line.decode())
        if not head or " 101 " not in head[0]:
            fail(f"no WebSocket at {address}: {head} {self.file.read1(2000)}")
        self.n = 0

    def frame(self, kind, payload):
        mask = os.urandom(4)
        size = len(payload)
        length = bytes([0x80 | size]) if size < 126 else bytes([0x80 | 126]) + struct.pack("!H", size)
        body = bytes(byte ^ mask[at % 4] for at, byte in enumerate(payload))
        self.socket.sendall(bytes([0x80 | kind]) + length + mask + body)

    def ask(self, kind, **fields):
        """Sends a message and returns what answers it."""
        self.n += 1
        self.frame(1, json.dumps({"type": kind, "n": self.n, **fields}).encode())
        while True:
            head = self.file.read(2)
            if len(head) < 2:
                fail(f"the stream ends instead of answering {kind}")
            size = head[1] & 0x7f
            if size > 125:
                size = int.from_bytes(self.file.read(2 if size == 126 else 8), "big")
            payload = self.file.read(size)
            if head[0] & 0x0f == 9:
                self.frame(10, payload)
            elif head[0] & 0x0f == 8:
                fail(f"the stream is closed instead of answering {kind}: {payload}")
            elif (answer := json.loads(payload)).get("re") == self.n:
                return answer

    def close(self):
        self.frame(8, struct.pack("!H", 1000))
        self.socket.close()


def drill(stream, cycle, between=lambda: None):
    """A short cycle; `between` happens while it runs."""
    now = time.strftime("%Y-%m-%dT%H:%M:%SZ", time.gmtime())
    started = stream.ask("start", cycle_id=cycle, tool="tool-worn", operation="bush", started_at=now, sent_at=now,
                         period_ms=10, channels=["depth_mm", "feed_drive_load_percent", "spindle_load_percent"])
    if started["type"] != "started":
        fail(f"the stream does not start a cycle: {started}")
    for first in range(10):
        if first == 5:
            between()
        told = stream.ask("samples", first=first, depth_mm=[0.1 * first], feed_drive_load_percent=[9.1],
                          spindle_load_percent=[12.0])
        if told["type"] != "override" or not 0 < told["override_percent"] <= 200:
            fail(f"no override for sample {first}: {told}")
    stored = stream.ask("end", samples=10)
    if (stored["type"], stored.get("status")) != ("stored", 201):
        fail(f"the cycle {cycle} is not stored: {stored}")


def trusting(folder):
    return ssl.create_default_context(cafile=folder / "chain.pem")


def check_tls(cell, folder):
    """The binary with TLS: its health check, and certificates that change under a stream that is open."""
    def metric(name):
        text = get(f"http://{cell.metrics}/metrics")
        return float(re.search(rf"^{name} (\S+)$", text, re.M)[1])

    def end():
        return metric(r'feedwright_tls_certificate_not_after_timestamp_seconds\{listener="api"\}')

    def failed():
        return metric(r'feedwright_tls_reloads_total\{outcome="failed"\}')

    if subprocess.run([FEEDWRIGHT, "healthcheck"], env=cell.environment, stdout=subprocess.DEVNULL, check=False).returncode:
        fail("the health check does not reach a service with TLS")
    trusted = {**cell.environment, "SSL_CERT_FILE": str(folder / "chain.pem"), "FEEDWRIGHT_TOKEN": cell.admin}
    listed = subprocess.run([FEEDWRIGHT, "token", "list", "--server", f"https://{cell.address}"], env=trusted, text=True,
                            capture_output=True, check=False)
    if "first start" not in listed.stdout:
        fail(f"tokens over TLS: {listed.stdout}{listed.stderr}")
    cell.register(trusting(folder))
    first = Stream(cell.address, "worn", cell.admin, trusting(folder))

    def renew():
        before = end()
        certificate(folder, 5)
        cell.process.send_signal(signal.SIGHUP)
        wait(lambda: f"SIGHUP changes nothing: {cell.log.read_text()}", lambda: end() < before - 86400)

    drill(first, "renewed", renew)
    # Whom the new certificate is shown to, and that the old one's stream goes on.
    second = urllib.request.urlopen(f"https://{cell.address}/healthz", timeout=30, context=trusting(folder))
    if second.status != 200:
        fail("the new certificate is not served")
    good = {name: (folder / name).read_bytes() for name in ("chain.pem", "key.pem")}
    trust, refused, until = trusting(folder), failed(), end()

    def spoil():
        (folder / "chain.pem").write_text("no certificate\n")
        cell.process.send_signal(signal.SIGHUP)
        wait(lambda: f"a bad certificate is not counted: {cell.log.read_text()}", lambda: failed() > refused)

    drill(first, "spoiled", spoil)
    if "the certificate was not taken over; the one in force stays" not in cell.log.read_text():
        fail(f"a bad certificate is not told of: {cell.log.read_text()}")
    if end() != until or urllib.request.urlopen(f"https://{cell.address}/healthz", timeout=30, context=trust).status != 200:
        fail("a bad certificate replaced the good one")
    for name, content in good.items():
        (folder / name).write_bytes(content)
    drill(first, "mended")
    first.close()
    print("TLS: health check, tokens, a stream that outlives a new certificate and a bad one, and a bad one refused")


def nginx(folder, plant, port):
    """nginx with the configuration that is deployed, but its addresses."""
    conf = (ROOT / "deploy/proxy/nginx.conf").read_text()
    for there, here in {
        "listen 443 ssl http2;": f"listen 127.0.0.1:{port} ssl http2;", "    listen [::]:443 ssl http2;\n": "",
        "/etc/feedwright/tls/fullchain.pem": str(folder / "chain.pem"),
        "/etc/feedwright/tls/key.pem": str(folder / "key.pem"), "server 127.0.0.1:7878;": f"server {plant.address};",
    }.items():
        if there not in conf:
            fail(f"the test does not find »{there}« in nginx.conf")
        conf = conf.replace(there, here)
    temporary = "".join(f"{of}_temp_path {folder}/nginx-{of};" for of in
                        ("client_body", "proxy", "fastcgi", "uwsgi", "scgi"))
    (folder / "nginx.conf").write_text(
        f"daemon off; pid {folder}/nginx.pid; error_log {folder}/nginx.log; events {{}}"
        f" http {{ access_log off; {temporary}\n{conf} }}")
    return subprocess.Popen([NGINX, "-q", "-e", folder / "nginx.log", "-c", folder / "nginx.conf"])


def caddy(folder, plant, port):
    """Caddy with the configuration that is deployed, but its addresses, and a certificate that nobody has to be asked for."""
    conf = (ROOT / "deploy/proxy/Caddyfile").read_text()
    for there, here in {
        "feedwright.example {": f"{{\n\tadmin off\n\tauto_https disable_redirects\n}}\nhttps://127.0.0.1:{port} {{\n"
                                f"\ttls {folder}/chain.pem {folder}/key.pem",
        "reverse_proxy 127.0.0.1:7878 {": f"reverse_proxy {plant.address} {{",
    }.items():
        if there not in conf:
            fail(f"the test does not find »{there}« in the Caddyfile")
        conf = conf.replace(there, here)
    (folder / "Caddyfile").write_text(conf)
    return subprocess.Popen([CADDY, "run", "--adapter", "caddyfile", "--config", folder / "Caddyfile"],
                            stdout=subprocess.DEVNULL, stderr=open(folder / "caddy.log", "w"),
                            env={**os.environ, "HOME": str(folder), "XDG_DATA_HOME": str(folder)})


def check_proxy(start, plant, folder, token):
    """A proxy in front: TLS, a machine's stream, live events at once, bodies as large as the service's, no metrics."""
    name, port = start.__name__, free_port()
    process = start(folder, plant, port)
    trust = trusting(folder)
    base = f"https://127.0.0.1:{port}"

    def reach(path, bearer=token, **more):
        headers = {"Authorization": f"Bearer {bearer}", **more.pop("headers", {})}
        request = urllib.request.Request(base + path, headers=headers, **more)
        return urllib.request.urlopen(request, timeout=30, context=trust)

    def status(path, **more):
        try:
            return reach(path, **more).status
        except urllib.error.HTTPError as error:
            return error.code
        except OSError:
            return None

    try:
        wait(lambda: f"{name} does not pass requests on: {(folder / (name + '.log')).read_text()}",
             lambda: status("/healthz") == 200)
        if status("/metrics") != 404:
            fail(f"{name} shows the metrics to everyone: {status('/metrics')}")
        # Larger than any proxy's default: it is the service that refuses it, for what is in it.
        large = b'{"cycle_id": "' + b"x" * (12 << 20)
        said = status("/v1/machines/worn/cycles", bearer=plant.admin, data=large, headers={"Content-Type": "application/json"})
        if said != 400:
            fail(f"a body of 12 MiB is answered {said} by {name}")
        identity = reach("/v1/machines").headers["X-Request-Id"]
        wait(lambda: f"the request {identity} through {name} is not in the log", lambda: identity in plant.log.read_text())
        with reach("/v1/live") as live:
            if live.readline().strip() in (b"", None):
                fail(f"the live events do not come through {name}")
            stream = Stream(f"127.0.0.1:{port}", "worn", plant.machine_token("worn"), trust)
            drill(stream, f"through-{name}")
            stream.close()
            # Unbuffered: the next event is this cycle's, long before a heartbeat or 4 KiB of events push it out.
            begin, seen = time.monotonic(), ""
            while f"through-{name}" not in seen or "event: cycle" not in seen:
                seen += live.readline().decode()
                if time.monotonic() - begin > 30:
                    fail(f"the cycle is not shown through {name}: {seen}")
        print(f"{name}: requests, a stream, live events, large bodies, and no metrics")
    finally:
        process.terminate()
        process.wait(timeout=30)


class Watch:
    """Debian's Prometheus with the configuration that is deployed, but its addresses and its pace."""

    def __init__(self, folder, targets, token):
        self.url = f"http://127.0.0.1:{free_port()}"
        config = yaml.safe_load((ROOT / "deploy/prometheus/prometheus.yml").read_text())
        config["global"] = {"scrape_interval": "1s", "evaluation_interval": "1s"}
        config["rule_files"] = [str(ROOT / "deploy/prometheus/rules/*.yml")]
        [job] = config["scrape_configs"]
        job["authorization"]["credentials_file"] = str(token)
        job["static_configs"] = [{"targets": targets}]
        (folder / "prometheus.yml").write_text(yaml.safe_dump(config))
        self.process = subprocess.Popen(
            [PROMETHEUS / "prometheus", f"--config.file={folder}/prometheus.yml", f"--storage.tsdb.path={folder}/tsdb",
             f"--web.listen-address={self.url[7:]}"], stderr=open(folder / "prometheus.log", "w"))

    def ask(self, path, **query):
        answer = json.loads(get(f"{self.url}/api/v1/{path}?{urllib.parse.urlencode(query, doseq=True)}"))
        return answer["data"]

    def up(self):
        try:
            found = self.ask("query", query='up{job="feedwright"} == 1')["result"]
        except OSError:
            return 0
        return len(found)

    def series(self, name):
        return len(self.ask("series", **{"match[]": name}))

    def firing(self):
        found = self.ask("query", query='ALERTS{alertstate="firing"}')["result"]
        return {alert["metric"]["alertname"] for alert in found}


def psql(address, sql, *more):
    ran = subprocess.run(["psql", "-X", "-q", "--csv", "-v", "ON_ERROR_STOP=1", *more, "-d", address],
                         input=sql, text=True, capture_output=True, check=False)
    if ran.returncode:
        fail(f"{sql}\n{ran.stderr}")
    return list(csv.DictReader(io.StringIO(ran.stdout)))


def check_metrics(server):
    text = get(f"http://{server.metrics}/metrics")
    ran = subprocess.run([PROMETHEUS / "promtool", "check", "metrics"], input=text, text=True, capture_output=True,
                         check=False)
    if ran.returncode or "does not remember" in ran.stderr:
        fail(f"promtool on {server.name}: {ran.stdout}{ran.stderr}")
    for secret in ("tool-worn", "sim-tool", "c12"):
        if f'"{secret}' in text:
            fail(f"{server.name}: {secret} is a label")


def rules():
    for file in sorted((ROOT / "deploy/prometheus/rules").glob("*.yml")):
        for group in yaml.safe_load(file.read_text())["groups"]:
            yield from group["rules"]


def metrics_of(expression):
    """Names of metrics and of recorded series in an expression."""
    bare = re.sub(r'"[^"]*"|\{[^}]*\}|\[[^\]]*\]', " ", expression)
    bare = re.sub(r"\b(?:by|on|without)\s*\([^)]*\)", " ", bare)
    return set(re.findall(r"\b(?:[a-z_]+:)?(?:feedwright|process)[a-z0-9_:]+|\bup\b", bare))


def check_rules(watch):
    names = set().union(*(metrics_of(rule["expr"]) for rule in rules()))
    names |= {rule["record"] for rule in rules() if "record" in rule}
    missing = set(names)

    def all_there():
        missing.difference_update({name for name in missing if watch.series(name)})
        return not missing

    wait(lambda: f"no series of {sorted(missing)}", all_there)
    unhealthy = [rule for group in watch.ask("rules")["groups"] for rule in group["rules"] if rule["health"] != "ok"]
    if unhealthy:
        fail(f"rules that do not evaluate: {unhealthy}")
    print(f"{len(names)} metrics of the rules are there")


def has_number(series):
    return any(value not in ("NaN", "+Inf", "-Inf") for _, value in series.get("values", [series.get("value")]))


class Panels:
    """Runs what Grafana would run."""

    def __init__(self, watch, plant, database, token):
        self.watch, self.plant, self.database, self.token = watch, plant, database, token
        self.now = time.time()
        self.begin = self.now - 3 * 3600

    def values(self, variable):
        query = variable["query"]
        found = re.fullmatch(r"label_values\((\w+), (\w+)\)", query)
        if found:
            return self.watch.ask(f"label/{found[2]}/values", **{"match[]": found[1]})
        return [next(iter(row.values())) for row in psql(self.database, query)]

    def substitute(self, text, name, value):
        iso = lambda at: time.strftime("%Y-%m-%dT%H:%M:%S.000Z", time.gmtime(at))
        for pattern, put in {
            f"${{{name}:sqlstring}}": f"'{value}'", f"${{{name}}}": value, f"${name}": value,
            "$__rate_interval": "20s", "$__unixEpochFrom()": str(int(self.begin)),
            "$__unixEpochTo()": str(int(self.now) + 1), "${__from:date:iso}": iso(self.begin),
            "${__to:date:iso}": iso(self.now + 1),
        }.items():
            text = text.replace(pattern, put)
        if "$" in text:
            fail(f"a variable that the test does not know: {text}")
        return text

    def prometheus(self, target, put):
        expression = put(target["expr"])
        if target["instant"]:
            result = self.watch.ask("query", query=expression)["result"]
        else:
            # The whole run, not only the last moment: a rate is gone when the fleet is.
            result = self.watch.ask("query_range", query=expression, start=self.now - 600, end=time.time(), step=1)
            result = result["result"]
        return any(map(has_number, result))

    def postgres(self, target, put):
        rows = psql(self.database, put(target["rawSql"]))
        return any(value for row in rows for name, value in row.items() if name not in ("time", "metric"))

    def api(self, target, put):
        text = get(self.plant.url + put(target["url"]), self.token)
        if target["type"] == "csv":
            rows = list(csv.DictReader(io.StringIO(text)))
            pick = lambda row, selector: row.get(selector)
        else:
            rows = json.loads(text)
            rows = rows[target["root_selector"]] if target["root_selector"] else [rows]
            def pick(row, selector):
                for part in selector.split("."):
                    row = (row or {}).get(part)
                return row
        wanted = [column["selector"] for column in target["columns"]]
        return bool(rows) and all(any(pick(row, selector) not in (None, "") for row in rows) or selector == "flags"
                                  for selector in wanted)

    def check(self, path):
        dashboard = json.loads(path.read_text())
        variables = dashboard["templating"]["list"]
        if len(variables) > 1:
            fail(f"{path.name}: the test knows one variable")
        name = variables[0]["name"] if variables else "none"
        values = self.values(variables[0]) if variables else ["none"]
        if not values:
            fail(f"{path.name}: the variable {name} has no values")
        if variables and variables[0]["multi"]:
            values.append(variables[0]["allValue"])
        count = 0
        for panel in dashboard["panels"]:
            for target in panel["targets"]:
                kind = target["datasource"]["type"]
                run = {"prometheus": self.prometheus, "grafana-postgresql-datasource": self.postgres,
                       "yesoreyeram-infinity-datasource": self.api}[kind]
                if not any(run(target, lambda text, value=value: self.substitute(text, name, value))
                           for value in values):
                    fail(f"{path.name}: »{panel['title']}« returns nothing: {target}")
                count += 1
        print(f"{path.name}: {count} queries return data")


def main():
    with tempfile.TemporaryDirectory(prefix="feedwright-watched-") as name:
        folder, running = pathlib.Path(name), []
        folder.chmod(0o755)
        try:
            base = POSTGRES.rsplit("/", 1)[0]
            psql(POSTGRES, "CREATE DATABASE plant")
            plant = Server(folder, "plant", f"{base}/plant")
            running.append(plant.process)
            certificate(folder, 90)
            cell = Server(folder, "cell", "", TLS__CERTIFICATE=folder / "chain.pem", TLS__KEY=folder / "key.pem",
                          TLS__RELOAD_INTERVAL_MS="3600000")
            running.append(cell.process)
            token = plant.viewer()
            file = folder / "token"
            file.write_text(token)
            watch = Watch(folder, [plant.address, cell.metrics], file)
            running.append(watch.process)
            wait(lambda: "Prometheus does not scrape", lambda: watch.up() == 2)
            fleet = plant.simulate()
            running.append(fleet)
            plant.wear_out()
            plant.refuse()
            for server in (plant, cell):
                server.back_up(folder / f"{server.name}.backup")
            if fleet.wait(timeout=400):
                fail("the simulated fleet stopped")
            check_metrics(plant)
            check_metrics(cell)
            check_tls(cell, folder)
            check_proxy(nginx, plant, folder, token)
            check_proxy(caddy, plant, folder, token)
            missing = set(MUST_FIRE)

            def fires():
                missing.difference_update(watch.firing())
                return not missing

            wait(lambda: f"these do not fire: {sorted(missing)}", fires)
            print(f"firing: {', '.join(sorted(watch.firing()))}")
            # What the operations page says to do ends the alert.
            send("POST", f"{plant.url}/v1/tools/tool-worn/events", plant.admin, {"kind": "changed"})
            worn = 'ALERTS{alertname="FeedwrightToolWorn",machine="worn"}'
            wait(lambda: "a tool that was changed stays worn", lambda: not watch.ask("query", query=worn)["result"])
            check_rules(watch)
            psql(f"{base}/plant", (ROOT / "deploy/grafana/role.sql").read_text(), "-v", "password='secret'")
            reader = f"{base}/plant".replace("feedwright@", "feedwright_grafana:secret@")
            refused = subprocess.run(["psql", "-X", "-d", reader, "-c", "SELECT 1 FROM tokens"], capture_output=True,
                                     text=True, check=False)
            if "permission denied" not in refused.stderr:
                fail(f"Grafana's role reads tokens: {refused.stdout}{refused.stderr}")
            panels = Panels(watch, plant, reader, token)
            for path in sorted((ROOT / "deploy/grafana/dashboards").glob("*.json")):
                panels.check(path)
        finally:
            for process in reversed(running):
                process.terminate()
            for process in running:
                process.wait(timeout=30)


main()
