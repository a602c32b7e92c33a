"""Whether the files under deploy/ agree with one another, with the repository and with the binary; see `lint`.

A mounted path that is not there, a data source that no dashboard finds, a probe of a path that nobody serves, a
setting with a typing error: no linter of one file sees them.
"""
import json
import os
import pathlib
import re
import subprocess
import sys
import tempfile

import yaml

ROOT = pathlib.Path(__file__).resolve().parents[2]
DEPLOY = ROOT / "deploy"
FEEDWRIGHT = sys.argv[1]
wrong = []


def expect(right, what):
    if not right:
        wrong.append(what)


def panels(board):
    for panel in board["panels"]:
        yield panel
        yield from panel.get("panels", [])


def compose():
    folder = DEPLOY / "compose"
    whole = yaml.safe_load((folder / "compose.yaml").read_text())
    services, made = whole["services"], (folder / "up").read_text()
    mounts = {}
    for name, service in services.items():
        for mount in service.get("volumes", []):
            source, target = mount.split(":")[:2]
            mounts.setdefault(name, {})[target] = source
            if source.startswith("."):
                by_up = source.startswith("./secrets/") and re.search(rf"\b{re.escape(source[10:])}\b", made)
                expect((folder / source).exists() or by_up, f"compose: {name} mounts {source}, which is not there")
            else:
                expect(source in whole["volumes"], f"compose: {name}'s volume {source} is not declared")
        expect("healthcheck" in service, f"compose: {name} has no health check")
        expect(service.get("restart"), f"compose: {name} does not come back")
        for port in service.get("ports", []):
            expect(port.startswith("127.0.0.1:"), f"compose: {name} publishes {port} to everyone")
        for variable, value in (service.get("environment") or {}).items():
            plain = re.search(r"PASSWORD|TOKEN|SECRET", variable) and not variable.endswith("_FILE")
            expect(not plain, f"compose: {name} has {variable}={value} in clear")
        for secret in service.get("secrets", []):
            expect(secret in whole["secrets"], f"compose: {name}'s secret {secret} is not declared")
        for other in service.get("depends_on", []):
            expect(other in services, f"compose: {name} depends on {other}, which is not there")
    for name, secret in whole["secrets"].items():
        source = secret["file"].removeprefix("./secrets/")
        expect(re.search(rf"\b{re.escape(source)}\b", made), f"compose: nobody makes the secret {name}")
    expect(services["feedwright"]["env_file"].removeprefix("secrets/") in made, "compose: nobody makes the env_file")
    build = services["feedwright"]["build"]
    expect((folder / build["context"] / build["dockerfile"]).is_file(), "compose: the Containerfile is not there")
    user = services["feedwright"].get("user", "")
    container = (DEPLOY / "container/Containerfile").read_text()
    expect(user and f"USER {user}\n" in container, f"compose: the user {user!r} is not the Containerfile's")
    for name in services:
        expect(services[name].get("user", "0") not in ("0", "root") or name == "postgres", f"compose: {name} runs as root")
    return services, mounts


def provisioning(services, mounts):
    mounted = mounts["grafana"]
    for file in (DEPLOY / "grafana/provisioning/dashboards").glob("*.yaml"):
        for provider in yaml.safe_load(file.read_text())["providers"]:
            path = provider["options"]["path"]
            expect(path in mounted, f"{file.name}: nothing is mounted at {path}")
            source = DEPLOY / "compose" / mounted.get(path, "none")
            expect(list(source.glob("*.json")), f"{file.name}: there is no dashboard in {source}")
    sources = {}
    for file in (DEPLOY / "grafana/provisioning/datasources").glob("*.yaml"):
        text = file.read_text()
        for source in yaml.safe_load(text)["datasources"]:
            sources[source["uid"]] = source["type"]
            host, _, port = source["url"].split("://")[-1].partition(":")
            expect(host in services, f"{file.name}: {host} is no service of compose")
            expect(port.isdigit(), f"{file.name}: {source['url']} has no port")
        for secret in re.findall(r"\$__file\{/run/secrets/([^}]*)\}", text):
            expect(secret in services["grafana"]["secrets"], f"{file.name}: Grafana has no secret {secret}")
    used = set()
    for file in (DEPLOY / "grafana/dashboards").glob("*.json"):
        board = json.loads(file.read_text())
        parts = [part for panel in panels(board) for part in (panel, *panel["targets"])] + board["templating"]["list"]
        for part in parts:
            source = part["datasource"]
            used.add(source["uid"])
            expect(sources.get(source["uid"]) == source["type"],
                   f"{file.name}: no data source {source['uid']} of type {source['type']} is provisioned")
    expect(used == set(sources), f"data sources that no dashboard uses: {set(sources) - used}")
    plugins = services["grafana"]["environment"]["GF_INSTALL_PLUGINS"].split(",")
    built_in = {"prometheus", "grafana-postgresql-datasource"}
    for kind in set(sources.values()) - built_in:
        expect(kind in plugins, f"compose: Grafana lacks the plugin {kind}")


def prometheus(services, mounts):
    config = yaml.safe_load((DEPLOY / "prometheus/prometheus.yml").read_text())
    mounted = mounts["prometheus"]
    for pattern in config["rule_files"]:
        source = mounted.get("/etc/prometheus/" + pattern.split("/")[0], "none")
        expect(list((DEPLOY / "compose" / source).glob(pattern.split("/")[1])), f"prometheus.yml: no rules at {pattern}")
    for job in config["scrape_configs"]:
        expect(job["authorization"]["credentials_file"] in mounted, "prometheus.yml: its token is not mounted")
        for target in (target for static in job["static_configs"] for target in static["targets"]):
            expect(target.split(":")[0] in services, f"prometheus.yml: {target} is no service of compose")


def kubernetes():
    objects = list(yaml.safe_load_all((DEPLOY / "kubernetes/feedwright.yaml").read_text()))
    kinds = {each["kind"]: each for each in objects}
    pod = kinds["Deployment"]["spec"]["template"]
    [container] = pod["spec"]["containers"]
    labels = pod["metadata"]["labels"].items()
    ports = {port["name"]: port["containerPort"] for port in container["ports"]}
    for what, selector in {
        "Deployment": kinds["Deployment"]["spec"]["selector"]["matchLabels"],
        "Service": kinds["Service"]["spec"]["selector"],
        "PodDisruptionBudget": kinds["PodDisruptionBudget"]["spec"]["selector"]["matchLabels"],
        "NetworkPolicy": kinds["NetworkPolicy"]["spec"]["podSelector"]["matchLabels"],
    }.items():
        expect(selector.items() <= labels, f"Kubernetes: {what} selects no pod")
    for name in ("startupProbe", "livenessProbe", "readinessProbe"):
        probe = container[name]["httpGet"]
        expect(probe["port"] in ports and probe["path"] in ("/healthz", "/readyz"), f"Kubernetes: {name} asks nobody")
    expect(kinds["Service"]["spec"]["ports"][0]["targetPort"] in ports, "Kubernetes: the Service reaches no port")
    for rule in kinds["NetworkPolicy"]["spec"]["ingress"]:
        expect(all(port["port"] in ports for port in rule["ports"]), "Kubernetes: the NetworkPolicy names no port")
    backend = kinds["Ingress"]["spec"]["rules"][0]["http"]["paths"][0]["backend"]["service"]["name"]
    expect(backend == kinds["Service"]["metadata"]["name"], "Kubernetes: the Ingress reaches no Service")
    expect(kinds["Deployment"]["spec"]["replicas"] > 1, "Kubernetes: one replica has no rolling upgrade")
    # A job is its replica's (docs/operations.md).
    expect(kinds["Service"]["spec"].get("sessionAffinity") == "ClientIP", "Kubernetes: the Service sends a client anywhere")
    annotations = kinds["Ingress"]["metadata"]["annotations"]
    expect("nginx.ingress.kubernetes.io/upstream-hash-by" in annotations, "Kubernetes: the Ingress sends a client anywhere")
    environment = {entry["name"]: entry.get("value") for entry in container["env"]}
    listen = environment["FEEDWRIGHT__METRICS__LISTEN"]
    expect(listen.endswith(f":{ports['metrics']}"), "Kubernetes: the metrics' port is another one")
    expect(pod["metadata"]["annotations"]["prometheus.io/port"] == str(ports["metrics"]), "Kubernetes: scraped elsewhere")
    grace, hook = pod["spec"]["terminationGracePeriodSeconds"], container["lifecycle"]["preStop"]["exec"]["command"]
    expect(grace > int(hook[-1]) + 20, "Kubernetes: killed before its shutdown is over")
    return {name: value for name, value in environment.items() if value} | image()


def image():
    """What the image sets, continued lines joined."""
    text = (DEPLOY / "container/Containerfile").read_text().replace("\\\n", " ")
    [line] = re.findall(r"^ENV (.*)$", text, re.M)
    found = dict(pair.split("=", 1) for pair in line.split())
    expect(f"EXPOSE {found['FEEDWRIGHT__SERVER__LISTEN'].split(':')[1]}\n" in text, "Containerfile: EXPOSE is another port")
    # A bare Debian trusts nobody: what is documented for this image needs the system's certificate authorities in it.
    last = re.split(r"^FROM ", text, flags=re.M)[-1]
    roots = re.search(r"^COPY .*/etc/ssl/certs/ca-certificates\.crt$", last, re.M)
    expect(roots, "Containerfile: no certificate authorities, so that sslmode=verify-full and https trust nobody")
    return found


def settings(environment, where, *arguments):
    """The binary itself says whether it knows every setting."""
    clean = {name: value for name, value in os.environ.items() if not name.startswith("FEEDWRIGHT")}
    ran = subprocess.run([FEEDWRIGHT, *arguments, "config"], env={**clean, **environment}, text=True, capture_output=True,
                         check=False)
    expect(ran.returncode == 0, f"{where}: {ran.stderr}")
    for name in (name for name in environment if name.startswith("FEEDWRIGHT")):
        expect(f"# {name}" in ran.stdout, f"{where}: {name} has no effect")


def operations():
    """What the operations page names is there: requests, settings, metrics and commands."""
    text = (ROOT / "docs/operations.md").read_text()
    paths = json.loads((ROOT / "openapi/openapi.json").read_text())["paths"]
    known = {(method.upper(), re.sub(r"\{[^}]*\}", "{}", path)) for path, of in paths.items() for method in of}
    asked = re.findall(r"\b(GET|POST|PUT|DELETE) (/v1/[^\s`)?]*)", text)
    for method, path in asked:
        expect((method, re.sub(r"\{[^}]*\}", "{}", path)) in known, f"operations.md: {method} {path} is nowhere")
    default = (ROOT / "service/server/src/config/default.toml").read_text()
    keys, section = set(), ""
    for line in default.splitlines():
        if found := re.match(r"\[(\w+)\]", line):
            section = found[1] + "."
        elif found := re.match(r"(\w+) = ", line):
            keys.add(section + found[1])
    sections = {key.split(".")[0] for key in keys if "." in key}
    named = [key for key in re.findall(r"`(\w+\.\w+)(?: = [^`]*)?`", text) if key.split(".")[0] in sections]
    for key in named:
        expect(key in keys, f"operations.md: there is no setting {key}")
    sources = "".join(path.read_text() for path in (ROOT / "service/server/src").rglob("metrics*/**/*.rs"))
    sources += (ROOT / "service/server/src/metrics.rs").read_text()
    metrics = set(re.findall(r"\bfeedwright_[a-z_]+", text)) - {"feedwright_grafana"}
    for metric in metrics:
        expect(f'"{metric}"' in sources, f"operations.md: there is no metric {metric}")
    listed = subprocess.run([FEEDWRIGHT, "--help"], text=True, capture_output=True, check=True).stdout
    # Lines that are commands, and code within a sentence; other words in front of the name make it another program's.
    code = re.findall(r"^ {4}(.*)$|`([^`\n]*)`", text, re.M)
    commands = {found[1] for line in code for part in line
                if (found := re.match(r"(?:[A-Z_]+=\S+ |15 2 \* \* \* root /usr/sbin/)*feedwright(?:-ctl)? ([a-z]+)\b", part))}
    for command in commands:
        expect(re.search(rf"^  {command} ", listed, re.M), f"operations.md: there is no command {command}")
    for file in re.findall(r"`((?:deploy|docs|tests)/[\w./-]+)`", text):
        expect((ROOT / file).exists(), f"operations.md: {file} is not there")
    found = [len(each) for each in (asked, named, metrics, commands)]
    expect(min(found) > 1, f"operations.md: the test does not find what it names: {found}")
    print(f"operations.md: {found[0]} requests, {found[1]} settings, {found[2]} metrics and {found[3]} commands are there")


def environment():
    """Whether feedwright-ctl reads a file of settings as systemd's EnvironmentFile= does (its env-file.c)."""
    script = (DEPLOY / "debian/feedwright-ctl").read_text()
    reader = re.search(r"^assignments\(\) \{\n.*?^\}\n", script, re.M | re.S)[0]
    cases = {
        "A=postgres://x?a=b&c$d\n": {"A": "postgres://x?a=b&c$d"},
        "  A=1\n\tB=2": {"A": "1", "B": "2"},
        "A=debug  \nB=5\r\nC = x y \n": {"A": "debug", "B": "5", "C": "x y"},
        'A="debug"  \nB=\'it"s\'\nC="a b  "\n': {"A": "debug", "B": 'it"s', "C": "a b  "},
        "A=x\\\\y\nB=a\\\nb\nC=\"\\$\\q\"\n": {"A": "x\\y", "B": "ab", "C": "$\\q"},
        "A=a'b\nB=\"two\nlines\"\n": {"A": "a'b", "B": "two\nlines"},
        "# A=1\n;B=2\nexport C=3\n4=5\nno assignment\nD=\n": {"D": ""},
        "": {},
    }
    with tempfile.NamedTemporaryFile("w", newline="") as file:
        for text, means in cases.items():
            file.seek(0)
            file.truncate()
            file.write(text)
            file.flush()
            read = subprocess.run(["sh", "-c", reader + 'eval "$(assignments "$1")"\nenv -0', "sh", file.name],
                                  env={"PATH": os.environ["PATH"]}, capture_output=True, text=True, check=True).stdout
            found = dict(each.split("=", 1) for each in read.split("\0") if each)
            found = {name: value for name, value in found.items() if name not in {"PATH", "PWD", "OLDPWD", "_"}}
            expect(found == means, f"feedwright-ctl reads {text!r} as {found}, not as {means}")
        file.seek(0)
        file.truncate()
        file.write("# kept in C:\\\nA=1\n")
        file.flush()
        told = subprocess.run(["sh", "-c", reader + 'assignments "$1"', "sh", file.name],
                              capture_output=True, text=True)
        expect(told.returncode == 1 and "ends in a backslash" in told.stderr, "feedwright-ctl guesses which line systemd takes")


services, mounts = compose()
operations()
environment()
provisioning(services, mounts)
prometheus(services, mounts)
settings(image(), "Containerfile")
settings(kubernetes(), "Kubernetes")
settings({}, "the package's configuration", "--config", str(DEPLOY / "debian/feedwright.toml"))
up = (DEPLOY / "compose/up").read_text()
[url] = re.findall(r"^ *printf '(FEEDWRIGHT__DATABASE__URL)=", up, re.M)
settings({url: "postgres://feedwright:secret@postgres/feedwright"}, "compose")
print("\n".join(wrong) or "compose, Grafana, Prometheus, Kubernetes, the container and the binary agree")
sys.exit(bool(wrong))
