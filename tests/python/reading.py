"""Reads a server of its own with pandas and pyarrow, and checks that every form holds the same figures.

usage: reading.py PATH-OF-FEEDWRIGHT
"""

import io
import json
import math
import re
import signal
import subprocess
import sys
import tempfile
import urllib.error
import urllib.request

import pandas as pd
import pyarrow as pa
import pyarrow.ipc
import pyarrow.parquet

# To the bit: what pandas 3 does by itself has to be asked of older ones.
EXACT = {} if int(pd.__version__.split(".")[0]) >= 3 else {"float_precision": "round_trip"}
JSON, CSV = "application/json", "text/csv"
# As docs/reading.md says: an id of digits is no number, and NA is one like any other.
TEXTS = ["machine", "cycle_machine", "cycle_id", "tool", "operation", "process", "strategy", "law_version", "profile_id",
         "recommendation_id", "outcome", "energy_best_basis", "flags", "measure", "unit", "basis", "idle_power"]
AS_IT_IS = {"dtype": dict.fromkeys(TEXTS, str), "keep_default_na": False, "na_values": [""]}
ARROW, PARQUET = "application/vnd.apache.arrow.stream", "application/vnd.apache.parquet"


class Server:
    """A server on a free port with a data directory of its own."""

    def __init__(self, binary, folder):
        self.process = subprocess.Popen(
            [binary, "--data-dir", folder, "--set", "server.listen=127.0.0.1:0", "serve"],
            stderr=subprocess.PIPE, text=True)
        log = ""
        while not (re.search(r"fwt_\S+", log) and re.search(r"listening.*?(127\.0\.0\.1:\d+)|(127\.0\.0\.1:\d+).*listening", log)):
            line = self.process.stderr.readline()
            assert line, f"the server ended: {log}"
            log += re.sub(r"\x1b\[[0-9;]*m", "", line)
        self.token = re.search(r"fwt_\S+", log).group(0)
        self.address = "http://" + re.search(r"127\.0\.0\.1:\d+", log).group(0)

    def ask(self, path, accept=JSON, body=None, method=None):
        request = urllib.request.Request(self.address + path, method=method)
        request.add_header("Authorization", f"Bearer {self.token}")
        request.add_header("Accept", accept)
        if body is not None:
            request.data = json.dumps(body).encode()
            request.add_header("Content-Type", "application/json")
        with urllib.request.urlopen(request) as answer:
            kind = answer.headers.get_content_type()
            return kind, answer.read()

    def stop(self):
        self.process.send_signal(signal.SIGTERM)
        self.process.communicate(timeout=30)


def frames(server, path):
    """The same answer in every form, as data frames."""
    read = {}
    kind, body = server.ask(path, CSV)
    assert kind == CSV, kind
    read["csv"] = pd.read_csv(io.BytesIO(body), **AS_IT_IS, **EXACT)
    kind, body = server.ask(path, ARROW)
    assert kind == ARROW, kind
    read["arrow"] = pa.ipc.open_stream(body).read_all()
    kind, body = server.ask(path, PARQUET)
    assert kind == PARQUET, kind
    read["parquet"] = pa.parquet.read_table(io.BytesIO(body))
    rows = path if "/v1/summaries" in path else path + "&layout=rows"
    read["json"] = pd.DataFrame(json.loads(server.ask(rows)[1])["items"])
    return read


def same(read, time):
    """Checks that the forms agree, to the bit, and returns the Arrow table."""
    table = read["arrow"]
    assert table.schema.field(time).type == pa.timestamp("us", tz="UTC"), table.schema
    assert table.equals(read["parquet"].cast(table.schema)), "Arrow and Parquet differ"
    frame = table.to_pandas()
    for name in ("csv", "json"):
        other = read[name]
        assert list(other.columns) == table.column_names, (name, list(other.columns))
        assert len(other) == table.num_rows, (name, len(other))
        # Every time looks alike, so that the format that the first row suggests fits all.
        times = pd.to_datetime(other[time], format="%Y-%m-%dT%H:%M:%S.%fZ", utc=True)
        assert (times == frame[time]).all(), name
        for field in table.schema:
            if field.type == pa.float64():
                values = zip(frame[field.name], other[field.name].astype(float))
                assert all(a == b or (math.isnan(a) and math.isnan(b)) for a, b in values), (name, field.name)
            if field.type == pa.string():
                texts = [None if pd.isna(text) else text for text in other[field.name]]
                assert texts == table[field.name].to_pylist(), (name, field.name, texts)
    return table


def texts_come_as_they_are(server, machine):
    """Ids and texts that a reader of CSV takes for a number, a truth, a formula or nothing."""
    server.ask("/v1/machines/NA", body=machine, method="PUT")
    texts = {"NA": "=1+1", "null": "+5", "nan": "-x", "007": "@a", "1e5": "1.10", "True": "NA", "None": "007", "inf": "1"}
    for number, (odd, law) in enumerate(texts.items()):
        server.ask("/v1/machines/NA/cycles", method="POST", body={
            "cycle_id": odd, "tool": "007", "operation": "null", "started_at": f"2026-05-05T00:00:{number:02}Z",
            "law_version": law, "reported": {"duration_ms": 1000}})
    rows = same(frames(server, "/v1/summaries?machine=NA"), "started_at")
    assert dict(zip(rows["cycle_id"].to_pylist(), rows["law_version"].to_pylist())) == texts
    assert set(rows["tool"].to_pylist()) == {"007"} and set(rows["operation"].to_pylist()) == {"null"}
    range_ = "from=2026-05-05T00:00:00Z&to=2026-05-05T01:00:00Z&bucket=1h"
    series = same(frames(server, f"/v1/series?by=tool&measures=duration_ms&{range_}"), "time")
    assert series["tool"].to_pylist() == ["007"], series


def main():
    folder = tempfile.mkdtemp(prefix="feedwright-reading-")
    server = Server(sys.argv[1], folder)
    try:
        put = lambda path, body: server.ask(path, body=body, method="PUT")
        machine = {
            "name": "Mill", "control": "sinumerik-840d", "ipo_period_ms": 10,
            "spindle": {"reference": "rated_power", "rated_power_watts": 7000},
            "feed_drive": {"reference": "unknown"},
            "limits": {"feed_min_mm_min": 1, "feed_max_mm_min": 5000, "override_min_percent": 5,
                       "override_max_percent": 200}}
        put("/v1/machines/M1", machine)
        put("/v1/tools/T1", {"name": "drill", "tool_type": "fd"})
        put("/v1/operations/O1", {"name": "bush", "process": "friction", "programmed_feed_mm_min": 140})
        loads = {}
        for number in range(40):
            load = [20 + number / 7 + 10 * math.sin(k / 30) for k in range(500)]
            load[250] = 170.0 + number
            loads[number] = load
            server.ask("/v1/machines/M1/cycles", method="POST", body={
                "cycle_id": f"c{number}", "tool": "T1", "operation": "O1",
                "started_at": f"2026-05-04T0{number // 20 * 3}:{number % 20:02}:00.{number:03}Z",
                "samples": {"period_ms": 10, "depth_mm": [k / 100 for k in range(500)], "spindle_load_percent": load}})

        table = same(frames(server, "/v1/machines/M1/cycles/c7/samples?from_ms=0"), "time")
        assert table.column_names == ["time", "time_ms", "depth_mm", "spindle_load_percent"]
        assert table.schema.field("spindle_load_percent").metadata[b"unit"] == b"%"
        assert table["spindle_load_percent"].to_pylist() == loads[7], "loads came back to the bit"
        few = same(frames(server, "/v1/machines/M1/cycles/c7/samples?points=40"), "time")
        assert few.num_rows <= 40 and max(few["spindle_load_percent"].to_pylist()) == 177.0

        summaries = same(frames(server, "/v1/summaries?tool=T1"), "started_at").to_pandas()
        assert len(summaries) == 40 and summaries["max_spindle_load_percent"].tolist() == [170.0 + n for n in range(40)]
        last = same(frames(server, "/v1/series?tool=T1&last=10"), "time")
        assert last["value"].to_pylist() == summaries["energy_rated_power_joules"].tolist()[-10:]

        range_ = "from=2026-05-04T00:00:00Z&to=2026-05-04T04:00:00Z&bucket=1h"
        buckets = same(frames(server, f"/v1/series?tool=T1&{range_}"), "time").to_pandas()
        assert buckets["count"].tolist() == [20, 0, 0, 20]
        assert buckets["mean"].isna().tolist() == [False, True, True, False], "a gap is no zero"
        # The figures are those that pandas itself makes of the summaries.
        hours = summaries.set_index("started_at")["energy_rated_power_joules"].resample("1h")
        for name, figures in {"p50": hours.median(), "p95": hours.quantile(0.95), "max": hours.max(),
                              "mean": hours.mean()}.items():
            for ours, theirs in zip(buckets[name].dropna(), figures.dropna()):
                assert math.isclose(ours, theirs, rel_tol=1e-12), (name, ours, theirs)
        texts_come_as_they_are(server, machine)
        try:
            server.ask("/v1/summaries", "text/html")
            raise AssertionError("text/html was answered")
        except urllib.error.HTTPError as refused:
            assert refused.code == 406, refused
    finally:
        server.stop()
    print("pandas and pyarrow read JSON, CSV, Arrow and Parquet, and all hold the same")


main()
