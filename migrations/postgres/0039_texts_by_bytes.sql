-- A database in SQL_ASCII counts the bytes of a text where others count its characters, of which a character may take four: it refused versions of
-- laws and reasons that the API takes, and cells that hold such could not be moved to it. These were the only two limits without room for that. All
-- rows were held to less before: nothing is looked through.
ALTER TABLE cycles DROP CONSTRAINT cycles_law_version_length;
ALTER TABLE cycles ADD CONSTRAINT cycles_law_version_length CHECK (length(law_version) BETWEEN 1 AND 256) NOT VALID;
ALTER TABLE cycle_overrides DROP CONSTRAINT cycle_overrides_law_version_length;
ALTER TABLE cycle_overrides ADD CONSTRAINT cycle_overrides_law_version_length
    CHECK (length(law_version) BETWEEN 1 AND 256) NOT VALID;
ALTER TABLE feed_profile_versions DROP CONSTRAINT feed_profile_versions_reason_length;
ALTER TABLE feed_profile_versions ADD CONSTRAINT feed_profile_versions_reason_length
    CHECK (length(reason) BETWEEN 1 AND 4000) NOT VALID;
