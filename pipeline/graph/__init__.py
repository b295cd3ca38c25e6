"""What is to be computed: nodes with keys, and those of them that are not in the store.

`graph` lays a study out as nodes: a task over a line, a chunk or the whole study;
`layers` lists the tasks that a study needs, and their parameters; `keys` makes keys of
all that decides a result; `plan` compares nodes with the store; `reads` is what a task
over the whole study reads.
"""
