"""The Sony ERS-210 walking in physics: model, locomotion and environment.

MuJoCo and MJX are imported by the modules that need them, when they are.
"""
