"""Risk of a drive by belief functions: driver, environment and vehicle, each from its sources, fused at two levels.

Frame {LR, MR, HR}: low, medium, high risk. A mass is an array of 8, indexed by the bit mask of its proposition:
LR = 1, MR = 2, HR = 4; 0 is the empty set (conflict), 7 is Theta (nothing is known).

References: the driver-behaviour paper (eq. 8-9); Shafer (1976); Smets & Kennes (1994);
Smarandache & Dezert (eds.), *Advances and Applications of DSmT for Information Fusion*, vol. 2 (2006).
"""
