"""Gene tables x reading of the outputs: see `experiments.sweeps`."""

from experiments import sweeps

if __name__ == "__main__":
    sweeps.main("layout")
