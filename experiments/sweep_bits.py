"""Bits a gene x plain binary or Gray code: see `experiments.sweeps`."""

from experiments import sweeps

if __name__ == "__main__":
    sweeps.main("bits")
