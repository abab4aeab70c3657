"""The control step: see `experiments.sweeps`."""

from experiments import sweeps

if __name__ == "__main__":
    sweeps.main("dt")
