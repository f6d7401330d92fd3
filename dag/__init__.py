"""The engine: reads the YAML, decides what to run, runs it on Dask. Knows no image science.

stage.py        what a stage says of itself
graph.py        pipeline.yaml -> checked graph
fingerprint.py  the keys; its docstring states the whole scheme
plan.py         which blocks there are, what each reads, which are known already
run.py          computes the rest; the only module that imports Dask
recall.py       the short cut of a fully cached run
explain.py      status and why: a plan held against what is in the store
"""
