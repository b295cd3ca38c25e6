"""What is still missing, and why: `graph` lays a study out as tasks, `missing` compares them with the journal."""
