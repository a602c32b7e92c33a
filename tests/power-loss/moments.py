"""When the power is lost: moments of a recording, by what was going on."""

import itertools

DATABASE, LOG, JOURNAL = (f"data/feedwright.sqlite3{end}" for end in ("", "-wal", "-groups"))
# Where the journal's first record stands (service/store/src/sqlite/journal.rs).
FIRST_RECORD = 4096


def by_sort(recording, exchanges):
    """Lines by what had just begun, been written or been answered then. Writes: right after their begin. Syncs: right before their end."""
    answered = {exchange.moment for exchange in exchanges if exchange.moment is not None}
    cycles = {exchange.moment for exchange in exchanges if exchange.moment is not None and exchange.acknowledged_cycles()}

    def operations(*kinds, path=None):
        return [operation for operation in recording.operations if operation.kind in kinds and path in (None, operation.path)]

    def begun(found):
        return {operation.begun + 1 for operation in found}

    def nearly_ended(found):
        return {operation.ended for operation in found}

    # The journal is made of zeros first, and of its head.
    writes = operations("write", path=JOURNAL)
    records = [operation for operation in writes if operation.offset >= FIRST_RECORD and any(operation.data)]
    first_records = [operation for operation in records if operation.offset == FIRST_RECORD]
    making = [operation for operation in writes if operation.offset < FIRST_RECORD or not any(operation.data)]
    starting, stopping = [], []
    for start, end in zip(recording.starts, recording.ends, strict=True):
        served = [moment for moment in answered if start < moment <= end]
        starting.append([operation for operation in recording.operations if start < operation.begun < min(served)])
        stopping += [operation for operation in recording.operations if max(served) < operation.begun <= end]
    return {
        "a cycle is acknowledged": {moment + 1 for moment in cycles},
        "something else is acknowledged": {moment + 1 for moment in answered - cycles},
        "the first start": begun(starting[0]),
        "a later start": begun(itertools.chain(*starting[1:])),
        "a stop": begun(stopping),
        "the journal is made": begun(operations("make", path=JOURNAL) + making),
        "a record of the journal": begun(records),
        "a sync of the journal": nearly_ended(operations("sync", path=JOURNAL)),
        "a later record of the journal": begun(operation for operation in records if operation.offset > FIRST_RECORD),
        "the journal begins anew": begun(first_records) | {operation.begun for operation in first_records},
        "a write to SQLite's log": begun(operations("write", path=LOG)),
        "a sync of SQLite's log": nearly_ended(operations("sync", path=LOG)),
        "SQLite's log begins anew": begun(operation for operation in operations("write", path=LOG) if operation.offset == 0),
        "a checkpoint": begun(operations("write", path=DATABASE)),
        "a sync of the database": nearly_ended(operations("sync", path=DATABASE)),
        "names": begun(operations("make", "make_directory", "remove", "rename")),
    }


def drawn(sorts, count, chance):
    """So many of them, of each sort in its turn, in the order of the recording: (line, sort)."""
    orders = [[(line, sort) for line in chance.sample(sorted(lines), len(lines))] for sort, lines in sorts.items()]
    turns = [moment for turn in itertools.zip_longest(*orders) for moment in turn if moment is not None]
    return sorted(turns[:count])
