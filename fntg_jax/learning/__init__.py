"""Learning, pure and without files.

`rollout` drives controllers through scenes, `fitness` judges the outcome, `objective` puts both
together; `ga` is the paper's genetic algorithm, `cma` and `gradient` refine what it found, and
`ask_tell` is the genetic algorithm behind evosax's interface.
"""

__all__ = ["ask_tell", "cma", "fitness", "ga", "gradient", "objective", "rollout"]
