"""Sweep of task team: see `experiments.team_sweeps`."""

from experiments import team_sweeps

if __name__ == "__main__":
    team_sweeps.main("noise")
