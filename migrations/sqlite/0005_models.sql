-- The model library, what operations say of their process, and what controls report of turning cuts.

-- Coefficients with the ranges they hold in, one entry per tool–work–machine set or work material. The body is JSON
-- that the store alone writes, after its type has checked it.
CREATE TABLE models (
    kind TEXT NOT NULL CONSTRAINT models_kind_word CHECK (kind IN ('turning', 'plunge')),
    model_id TEXT NOT NULL CONSTRAINT models_model_id_length CHECK (length(model_id) BETWEEN 1 AND 128),
    body TEXT NOT NULL CONSTRAINT models_body_length CHECK (length(body) BETWEEN 2 AND 10000),
    version INTEGER NOT NULL CONSTRAINT models_version_range CHECK (version BETWEEN 1 AND 9007199254740991),
    updated_at_us INTEGER NOT NULL,
    PRIMARY KEY (kind, model_id)
) WITHOUT ROWID, STRICT;

ALTER TABLE operations ADD COLUMN setup TEXT
    CONSTRAINT operations_setup_length CHECK (length(setup) BETWEEN 2 AND 10000);

-- Beside `cycles` and not in it: only turning has it, and the count of quantities there stays what it was.
CREATE TABLE cycle_cuts (
    machine_id TEXT NOT NULL,
    cycle_id TEXT NOT NULL,
    cutting_speed_m_min REAL
        CONSTRAINT cycle_cuts_cutting_speed_m_min_range CHECK (cutting_speed_m_min BETWEEN 0.001 AND 100000.0),
    feed_mm_rev REAL CONSTRAINT cycle_cuts_feed_mm_rev_range CHECK (feed_mm_rev BETWEEN 0.000001 AND 100.0),
    spindle_power_watts REAL
        CONSTRAINT cycle_cuts_spindle_power_watts_range CHECK (spindle_power_watts BETWEEN 0.000001 AND 1e9),
    thrust_newtons REAL
        CONSTRAINT cycle_cuts_thrust_newtons_range CHECK (thrust_newtons BETWEEN 0.000001 AND 1e9),
    edge_wear_mm REAL CONSTRAINT cycle_cuts_edge_wear_mm_range CHECK (edge_wear_mm BETWEEN 0.0 AND 100.0),
    PRIMARY KEY (machine_id, cycle_id)
) WITHOUT ROWID, STRICT;

-- The paper's own entry: Sandvik GC435 inserts, 709M40 steel, Colchester Mascot lathe (Alaskari & Oraby 2017, Eq. 1
-- to 3; the exponent of V printed in Eq. 1 is a misprint). Scatter as fitted there. No plunge entry: Lengerov gives
-- no constants.
INSERT INTO models (kind, model_id, body, version, updated_at_us) VALUES ('turning', 'alaskari-oraby-2017',
'{"set":{"tool":"Sandvik GC435","work":"709M40 (En 19) steel","machine":"Colchester Mascot"},"reference_depth_mm":1.0,"wear":{"coefficient":0.00762,"speed_exponent":0.577,"feed_exponent":0.168,"depth_exponent":0.248,"time_exponent":0.245},"power":{"coefficient":0.14,"speed_exponent":0.82,"feed_exponent":0.627,"depth_exponent":0.844,"wear_exponent":0.342},"force":{"coefficient":55354.0,"speed_exponent":-0.484,"feed_exponent":0.236,"depth_exponent":0.715,"wear_exponent":1.1},"ranges":{"speed_m_min":{"min":50.0,"max":200.0},"feed_mm_rev":{"min":0.06,"max":0.6},"depth_mm":{"min":1.5,"max":3.0}},"scatter":{"wear_log_sd":0.1,"power_log_sd":0.062,"force_log_sd":0.12}}',
1, 0);
