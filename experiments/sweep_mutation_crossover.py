"""Mutation rate x crossover rate: see `experiments.sweeps`."""

from experiments import sweeps

if __name__ == "__main__":
    sweeps.main("mutation_crossover")
