"""What is to be computed: `graph` lays a study out as nodes with keys, `plan` is those that are not in its store."""
