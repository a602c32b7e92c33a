-- Which operations the cycles of a fold ran, each with when the first of them began, and of how many cycles that is told (`codec/ran.rs`): what a
-- change of an operation has to do with a fold is known without reading its cycles. A server of before notes nothing, and nothing is noted
-- of what is there: it is found out by who makes folds anew in the background, once for each.
ALTER TABLE tool_wear ADD COLUMN ran BYTEA;
