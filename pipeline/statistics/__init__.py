"""Statistics of success and failure: plain functions of counts and boolean outcomes, no clock, no hidden randomness.

`proportions` speaks of one policy, `paired` of two on the same scenes, `sequential` of looking more than once,
`promotion` is the rule of the gate, `seeds` and `interquartile` pool whole runs, `prediction` asks how well the gate
foretold the exam.
"""

from pipeline.statistics.interquartile import bootstrap_interquartile, interquartile_mean
from pipeline.statistics.paired import McNemar, Pairs, compare, loss_upper, mcnemar
from pipeline.statistics.prediction import Prediction, predict_quality
from pipeline.statistics.proportions import deployment_mix, wilson
from pipeline.statistics.seeds import Interval, SignTest, bootstrap_difference, sign_test
from pipeline.statistics.sequential import further_scenes_to_bound, further_scenes_to_show, holm, outlook, spend

__all__ = [
    "Interval",
    "McNemar",
    "Pairs",
    "Prediction",
    "SignTest",
    "bootstrap_difference",
    "bootstrap_interquartile",
    "compare",
    "deployment_mix",
    "further_scenes_to_bound",
    "further_scenes_to_show",
    "holm",
    "interquartile_mean",
    "loss_upper",
    "mcnemar",
    "outlook",
    "predict_quality",
    "sign_test",
    "spend",
    "wilson",
]
