-- When each machine was last heard of. The views for Grafana are PostgreSQL's: a dashboard beside a cell reads the
-- service's own JSON and CSV, never its database file.

-- By the server's clock, and apart from the cycles: it is noted once in a while, not with every cycle, and a machine
-- whose own clock is wrong is not silent for it.
CREATE TABLE machine_contacts (
    machine_id TEXT PRIMARY KEY NOT NULL
        CONSTRAINT machine_contacts_machine_id_length CHECK (length(machine_id) BETWEEN 1 AND 128),
    last_cycle_at_us INTEGER NOT NULL
) WITHOUT ROWID, STRICT;

INSERT INTO machine_contacts (machine_id, last_cycle_at_us)
SELECT machine_id, MAX(received_at_us) FROM cycles GROUP BY machine_id;
