"""The paper's comparisons, run: every row of a table is trained, scored, and shown beside the paper's number."""
