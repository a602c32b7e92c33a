"""Prometheus, Grafana's queries and Feedwright, together; see `watched`, which calls this."""
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
import subprocess
import sys
import tempfile
import time
import urllib.error
import urllib.parse
import urllib.request

import yaml

ROOT = pathlib.Path(__file__).resolve().parents[2]
FEEDWRIGHT, PROMETHEUS, NGINX = sys.argv[1], pathlib.Path(sys.argv[2]), sys.argv[3]
POSTGRES = os.environ["FEEDWRIGHT_TEST_POSTGRES"]
# Firing without a waiting time, and each from another source: an alarm, the watch's round, a counter.
MUST_FIRE = {"FeedwrightToolWorn", "FeedwrightMachineSilent", "FeedwrightCyclesRejected",
             "FeedwrightCertificateExpiring"}
PATIENCE_S = 180


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
        limits = {"feed_min_mm_min": 1, "feed_max_mm_min": 5000, "override_min_percent": 5,
                  "override_max_percent": 200}
        machine = {"name": "Mill", "control": "sinumerik-840d", "ipo_period_ms": 10, "limits": limits,
                   "spindle": {"reference": "unknown"}, "feed_drive": {"reference": "unknown"}}
        operation = {"name": "Bush", "process": "friction", "programmed_feed_mm_min": 140}
        send("PUT", f"{self.url}/v1/operations/bush", self.admin, operation)
        # Within an hour of now, so that every dashboard's range holds it.
        begin = time.time() - 1800
        for name, cycles in (("near-end", 40), ("worn", 80)):
            send("PUT", f"{self.url}/v1/machines/{name}", self.admin, machine)
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


def check_tls(cell, folder):
    """The binary with TLS: its own health check, and a certificate that is taken over on SIGHUP."""
    def end():
        text = get(f"http://{cell.metrics}/metrics")
        return float(re.search(r"feedwright_tls_certificate_not_after_timestamp_seconds\{[^}]*\} (\S+)", text)[1])

    if subprocess.run([FEEDWRIGHT, "healthcheck"], env=cell.environment, stdout=subprocess.DEVNULL, check=False).returncode:
        fail("the health check does not reach a service with TLS")
    trusted = {**cell.environment, "SSL_CERT_FILE": str(folder / "chain.pem"), "FEEDWRIGHT_TOKEN": cell.admin}
    listed = subprocess.run([FEEDWRIGHT, "token", "list", "--server", f"https://{cell.address}"], env=trusted, text=True,
                            capture_output=True, check=False)
    if "first start" not in listed.stdout:
        fail(f"tokens over TLS: {listed.stdout}{listed.stderr}")
    before = end()
    certificate(folder, 5)
    cell.process.send_signal(signal.SIGHUP)
    wait(lambda: f"SIGHUP changes nothing: {cell.log.read_text()}", lambda: end() < before - 86400)
    print("TLS: health check, tokens, and a certificate taken over on SIGHUP")


def check_proxy(plant, folder, token):
    """nginx with the configuration that is deployed, but its addresses: TLS, live events at once, no metrics."""
    port = free_port()
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
    process = subprocess.Popen([NGINX, "-q", "-e", folder / "nginx.log", "-c", folder / "nginx.conf"])
    trust = ssl.create_default_context(cafile=folder / "chain.pem")
    base = f"https://127.0.0.1:{port}"

    def reach(path, timeout=30):
        request = urllib.request.Request(base + path, headers={"Authorization": f"Bearer {token}"})
        return urllib.request.urlopen(request, timeout=timeout, context=trust)

    def up():
        try:
            return reach("/healthz").status == 200
        except OSError:
            return False

    try:
        wait(lambda: f"nginx does not pass requests on: {(folder / 'nginx.log').read_text()}", up)
        try:
            reach("/metrics")
            fail("nginx shows the metrics to everyone")
        except urllib.error.HTTPError as error:
            if error.code != 404:
                fail(f"nginx answers {error.code} for the metrics")
        with reach("/v1/live") as live:
            # A heartbeat comes after 10 s at the latest; buffered, it would come with 4 KiB of them.
            line = live.readline()
            if not line.strip():
                fail("the live events do not come through nginx")
        print("nginx: requests, live events, and no metrics")
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
    if ran.returncode or ran.stderr:
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
            if fleet.wait(timeout=400):
                fail("the simulated fleet stopped")
            check_metrics(plant)
            check_metrics(cell)
            check_tls(cell, folder)
            check_proxy(plant, folder, token)
            missing = set(MUST_FIRE)

            def fires():
                missing.difference_update(watch.firing())
                return not missing

            wait(lambda: f"these do not fire: {sorted(missing)}", fires)
            print(f"firing: {', '.join(sorted(watch.firing()))}")
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
