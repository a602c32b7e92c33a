-- Feed profiles: a line per operation, tool type and wear band, and its versions. A version's content is written once;
-- only where it stands in draft, shadow, approved, active, superseded changes. At most one version of a line is active.

CREATE TABLE feed_profiles (
    profile_id TEXT PRIMARY KEY NOT NULL
        CONSTRAINT feed_profiles_profile_id_length CHECK (length(profile_id) BETWEEN 1 AND 128),
    operation_id TEXT NOT NULL CONSTRAINT feed_profiles_operation_id_length CHECK (length(operation_id) BETWEEN 1 AND 128),
    tool_type TEXT NOT NULL CONSTRAINT feed_profiles_tool_type_length CHECK (length(tool_type) BETWEEN 1 AND 1000),
    -- Level of wear from which it is meant, in thousandths; 1000 is the new tool.
    wear_from INTEGER NOT NULL CONSTRAINT feed_profiles_wear_from_range CHECK (wear_from BETWEEN 1000 AND 2000),
    revision INTEGER NOT NULL CONSTRAINT feed_profiles_revision_range CHECK (revision BETWEEN 1 AND 9007199254740991),
    active_version INTEGER
        CONSTRAINT feed_profiles_active_version_range CHECK (active_version BETWEEN 1 AND 4294967295),
    created_at_us INTEGER NOT NULL,
    updated_at_us INTEGER NOT NULL,
    CONSTRAINT feed_profiles_line UNIQUE (operation_id, tool_type, wear_from)
) WITHOUT ROWID, STRICT;

CREATE INDEX feed_profiles_active ON feed_profiles (operation_id) WHERE active_version IS NOT NULL;

CREATE TABLE feed_profile_versions (
    profile_id TEXT NOT NULL,
    version INTEGER NOT NULL CONSTRAINT feed_profile_versions_version_range CHECK (version BETWEEN 1 AND 4294967295),
    content_hash BLOB NOT NULL CONSTRAINT feed_profile_versions_content_hash_length CHECK (length(content_hash) = 32),
    content TEXT NOT NULL CONSTRAINT feed_profile_versions_content_length CHECK (length(content) BETWEEN 1 AND 20000),
    state TEXT NOT NULL
        CONSTRAINT feed_profile_versions_state_word
            CHECK (state IN ('draft', 'shadow', 'approved', 'active', 'superseded')),
    source TEXT NOT NULL
        CONSTRAINT feed_profile_versions_source_word CHECK (source IN ('drawn', 'imported', 'optimised')),
    based_on INTEGER CONSTRAINT feed_profile_versions_based_on_range CHECK (based_on BETWEEN 1 AND 4294967295),
    reason TEXT NOT NULL CONSTRAINT feed_profile_versions_reason_length CHECK (length(reason) BETWEEN 1 AND 1000),
    report TEXT CONSTRAINT feed_profile_versions_report_length CHECK (length(report) BETWEEN 2 AND 200000),
    author TEXT NOT NULL CONSTRAINT feed_profile_versions_author_length CHECK (length(author) BETWEEN 1 AND 1000),
    drafted_at_us INTEGER NOT NULL,
    shadowed_by TEXT,
    shadowed_at_us INTEGER,
    approved_by TEXT,
    approved_at_us INTEGER,
    activated_by TEXT,
    activated_at_us INTEGER,
    -- Revision of the line at which it became active: the order for rolling back.
    activated_revision INTEGER,
    superseded_at_us INTEGER,
    rolled_back INTEGER NOT NULL DEFAULT 0 CONSTRAINT feed_profile_versions_rolled_back_range CHECK (rolled_back IN (0, 1)),
    PRIMARY KEY (profile_id, version),
    CONSTRAINT feed_profile_versions_once UNIQUE (profile_id, content_hash),
    CONSTRAINT feed_profile_versions_second_person CHECK (approved_by IS NULL OR approved_by <> author),
    CONSTRAINT feed_profile_versions_approved CHECK (state IN ('draft', 'shadow') OR approved_by IS NOT NULL)
) WITHOUT ROWID, STRICT;

CREATE UNIQUE INDEX feed_profile_versions_one_active ON feed_profile_versions (profile_id) WHERE state = 'active';

-- The cycles that ran a version, newest first: what versions are compared by.
CREATE INDEX cycles_by_profile ON cycles (profile_id, profile_version, started_at_us) WHERE profile_id IS NOT NULL;
