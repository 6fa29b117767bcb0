"""How the learned classifier is made: random drives, what the whole chain sees of them, and the trees that fit it.

Import from the modules: `drives` (scenes of known things), `examples` (features and classes), `fit` (needs
scikit-learn), `score`, `lots` (which drives to learn from, and to be judged on).
"""
