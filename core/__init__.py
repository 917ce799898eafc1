"""Pure numerics of telefuse: no clock, file, network, log or randomness of its own.

Conventions, once for the whole package:

Frames
    ``e`` Earth-centred Earth-fixed, ``i`` inertial, ``n`` local north-east-down,
    ``b`` vehicle body forward-right-down, ``s`` sensor axes of the box.
    ``C_n_from_b`` turns body vectors into navigation vectors; ``q_n_from_b`` is the same
    rotation as a Hamilton quaternion, scalar first, w >= 0.
Vectors
    Velocity over ground ``v_n``, specific force ``f_b`` (a box at rest and level reads
    ``(0, 0, -g)``), angular rate of the body against inertial space ``omega_b``.
Angles
    Roll, pitch and yaw are the aerospace sequence C_n_from_b = Rz(yaw) Ry(pitch) Rx(roll);
    yaw is the heading, clockwise from north. The mounting is C_b_from_s in the same sequence.
Units
    SI and radians inside the core; where a value crosses the border its unit is in its name.
    Heights are above the WGS-84 ellipsoid unless the name says ``msl``.
Time
    UTC in integer nanoseconds, ``t_ns``; differences become float seconds, never absolute times.
Uncertainty
    ``_sd`` and ``_var`` say which; an innovation is z - h(x).
Missing values
    NaN in float columns. Nothing that is missing is ever zero.
Determinism
    The same samples give the same bits however they are cut into blocks. So per-sample work is
    done in explicit loops or element-wise; no BLAS call or pairwise sum runs over a block's length.

References: Groves, *Principles of GNSS, Inertial, and Multisensor Integrated Navigation Systems*,
2nd ed. (2013); Titterton & Weston (2004); NIMA TR8350.2 (WGS-84).
"""
