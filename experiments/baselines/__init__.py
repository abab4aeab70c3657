"""What `experiments/benchmark.py` compares the library with: plain C, plain NumPy, naive JAX, and
evosax, DEAP and pygad."""
