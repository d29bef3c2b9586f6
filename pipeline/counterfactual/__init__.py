"""Counterfactuals: both policies go on from the moment at which they disagreed, and we see who was right.

`ride` gives what a policy would have done along recordings, `windows` where two policies part for a while, `moment`
what has to be restored, `restore` restores it and proves that by replay, `branches` lets both go on under new noise
and slightly other physics, `judging` says who was right, `change` what a promotion would change.

Nothing in here knows whose physics it runs in: a Lab is handed in.
"""
