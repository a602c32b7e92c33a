-- A sum over each row of what people register, so that a number that a disk has changed is not advised by as if it were right. It is made by
-- the program when it writes the row, over what it writes; `summed_version` is the version that it was made of. Rows that are there have none
-- until a server sums them, which it does after its start: none says nothing.
ALTER TABLE machines ADD COLUMN row_sum INTEGER;
ALTER TABLE machines ADD COLUMN summed_version INTEGER;
ALTER TABLE calibrations ADD COLUMN row_sum INTEGER;
ALTER TABLE calibrations ADD COLUMN summed_version INTEGER;
ALTER TABLE tools ADD COLUMN row_sum INTEGER;
ALTER TABLE tools ADD COLUMN summed_version INTEGER;
ALTER TABLE operations ADD COLUMN row_sum INTEGER;
ALTER TABLE operations ADD COLUMN summed_version INTEGER;
ALTER TABLE models ADD COLUMN row_sum INTEGER;
ALTER TABLE models ADD COLUMN summed_version INTEGER;
