"""Trials that try to break the store, each of them made by a part and a seed.

    make chaos                            every part, and the table in docs/reliability.md
    make chaos PART=flips                 one part
    make chaos PART=flips SEED=17 TRIALS=1    one trial again

outcome.py      what a trial can end as, and the table
bench.py        the tiny capture and its store; commands in processes of their own; the truth
interference.py what happens to a command at one of its calls: it is held, refused, or its store goes away

flips.py        bits, bytes and files of a store change
kills.py        a command is killed at a system call
disks.py        disks that are full, read-only, without links, or gone
races.py        two commands at once, one held in the middle
edits.py        one of each thing that can change an answer is edited
workers.py      clusters without workers, with other code, with another store
malformed.py    files, names and options that cannot be right
equivalence.py  ways of running that must give the same bits, changes that must cost only what they must

`pytest` collects none of these but a few trials of each (test_chaos.py).
"""
