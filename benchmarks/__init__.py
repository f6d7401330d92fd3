"""Every speed and accuracy figure in README and docs, runnable.

python -m benchmarks.kernels     the per-pixel kernels against numpy, OpenCV and a copy of the same bytes
python -m benchmarks.pipeline    whole runs: end to end, cached, memory, processes
python -m benchmarks.accuracy    degrees against truth; writes docs/accuracy.md and its figures
"""
