"""The engine: reads the YAML, decides what to run, runs it on Dask. Knows no image science.

stage.py        what a stage says of itself
graph.py        pipeline.yaml -> checked graph
sources.py      our own source files, and what of them this process executes
code.py         what a module's code is, found once and remembered
fingerprint.py  the keys; its docstring states the whole scheme
plan.py         which blocks there are, what each reads, which are known already
task.py         one block, wherever it is computed: the kernel, its inputs, its record
places.py       where tasks are computed; the only module that imports Dask
run.py          computes what is not known yet, and publishes it
publish.py      from known blocks to result groups
request.py      what is asked for
answer.py       the one way of asking: a request is answered from memory, or by computing
recall.py       the short cut of a fully cached run
watcher.py      who is told how a run goes on
explain.py      status and why: a plan held against what is in the store

Importing it lets `sources` record what is imported from then on.
"""

from lightstage.dag.sources import record_imports

record_imports()
