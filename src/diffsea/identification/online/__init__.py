"""Online estimation: a vessel's parameters while it runs, and what of them a controller may have.

Estimators (`ekf`, `rls`) give a belief after every measurement; `trust` judges it and `guarded`
hands on what stood the test of time. The room uses the process noise and the datasets of the
offline fit and nothing else of `identification`.
"""
