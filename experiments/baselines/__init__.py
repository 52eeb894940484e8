"""The paper's own method (docs: the paper's Eq. 3, 5, 6 and 7), to be compared with.

Only the modules `kinematics`, `descent`, `coarse`, `registration`, `fine` and `relocalize` import
torch (the extra `baseline`); nothing else of the project does through them.
"""
