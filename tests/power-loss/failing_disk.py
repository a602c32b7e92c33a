"""A disk that cannot write what it took: the system drops it, and tells it by the next sync alone.

A server that goes on after a sync of its database has failed would sync it again, be told nothing, and begin its log anew, which holds alone
what the disk has not. So it has to end, acknowledge nothing more, and leave the log as it is for the next one.
"""

import os
import subprocess
import time

import load
from service import PATIENCE_S, Connection, Service


# What strace says of a call that it has refused.
REFUSED = "(INJECTED)"


def read(syncs):
    with open(syncs, encoding="ascii") as file:
        return file.read()


def has_failed(syncs):
    return REFUSED in read(syncs)


def hold(binary, folder, seed):
    """Whether a server ends by the first sync of its database that fails, with all that it has acknowledged; what is wrong otherwise."""
    sent = load.Load(seed)
    first = Service(binary, folder)
    sent.to(first)
    sent.register_all()
    if (status := first.stop()) != 0:
        return [f"a server that nothing happened to: {status}"]
    database = os.path.join(first.disk, "data", "feedwright.sqlite3")
    # The first one is that of its start.
    syncs = os.path.join(folder, "syncs")
    service = Service(binary, folder, refused_sync=(database, 2, syncs))
    sent.to(service)
    end, machines = time.monotonic() + PATIENCE_S, 0
    while not has_failed(syncs) and time.monotonic() < end:
        machine = load.MACHINES[machines % len(load.MACHINES)]
        machines += 1
        sent.post(machine, sent.cycle(machine))
    # Nobody posts from here on, so that another checkpoint has the time to come.
    try:
        service.process.wait(PATIENCE_S)
    except subprocess.TimeoutExpired:
        service.kill()
        return ["the server goes on after a sync of its database has failed"]
    Service.running.discard(service)
    faults = [f"its exit status is {service.process.returncode}"] if service.process.returncode != 1 else []
    if "checkpoint failed" not in service.said():
        faults.append(f"it does not say that a checkpoint failed: {service.said()[-1000:]}")
    if not os.path.exists(f"{database}-wal") or not os.path.getsize(f"{database}-wal"):
        faults.append("the log is gone, of which a part may not be in the database")
    after = read(syncs).partition(REFUSED)[2]
    if "sync(" in after:
        faults.append(f"the database is synced again: {after}")
    acknowledged = [(exchange.machine, exchange.id) for exchange in sent.exchanges if exchange.acknowledged_cycles()]
    if not acknowledged:
        faults.append("nothing was acknowledged before: this holds nothing")
    last = Service(binary, folder)
    connection = Connection(last.port, sent.token)
    for machine, cycle in acknowledged:
        if (status := connection.send("GET", f"/v1/machines/{machine}/cycles/{cycle}")[0]) != 200:
            faults.append(f"{machine}/{cycle} is lost: {status}")
    last.stop()
    check = subprocess.run([binary, "--data-dir", os.path.join(last.disk, "data"), "check"], capture_output=True, text=True, check=False)
    return faults + ([f"feedwright check: {check.stdout}{check.stderr}"] if check.returncode else [])
