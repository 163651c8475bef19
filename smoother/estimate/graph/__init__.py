"""The factor-graph smoother, on GTSAM. What it minimises is written in docs/graph.md; this is where it is done.

Every module imports only from those above it, so that the list may be read from top to bottom; whoever wants to see
the course of a session first begins at the end, with `smoother`.

Unknowns and samples
    options         what can be chosen, with where each figure comes from
    state           the unknowns: 18 of each keyframe, and 31 constants of the session
    keyframes       when there are keyframes
    sampled         which times the inertial samples cover
    made_up         samples in place of those that are missing
    imu             samples averaged to bins between keyframes, and the dense path that they describe
    arm             which way the lever arm points: with the box, or with the kart under a steering wheel

The linear system
    chain           solve and invert a bordered block-tridiagonal system
    relaxation      how much of a step to go, where full ones swing to and fro

Inertial factors
    inertial_noise  noise of the samples, and what an interval has of it
    preintegration  GTSAM's preintegration of each interval
    increments      residuals and Jacobians of CombinedImuFactor for all intervals at once
    inertial        these factors, linearised into the chain

What is expected of the motion between keyframes
    wiener          the multichannel Wiener filter
    expected        the most probable motion, of samples and fixes
    response        how a receiver answers to a change of velocity
    heading         heading of the magnetic field

All other factors: rows
    claims          what a receiver claims of its fixes, and when it was another
    rows            residual and Jacobians of each kind of measurement
    normal_equations  rows, whitened and added to the system
    slip            wheels roll along and hardly sideways
    upright         a kart stays upright, where the gyroscope hardly tells
    inputs          noise, priors and measurements that a graph is given
    session_rows    which rows a session has, with robust weights

Solving for noise that is given, and finding the noise
    batch           Gauss-Newton on everything at once
    incremental     the same graph by GTSAM's ISAM2
    row_components  squared residuals of measurements, and what is expected of them
    told            how well a session tells its noise
    components      noise from residuals: variance components
    noise_steps     how much of a step the noise goes
    lasting         errors of velocities that last for a second or two
    at_rest         what velocities tell while the kart stands

From a session to its solution
    first_noise     noise to begin with
    start           all that is known before the first step
    parts           parts of a start
    begin           a session brought to one clock, without pauses, and aligned
    coarse          first steps, on few keyframes
    edges           jumps of the fixes beside outages
    solve           noise and constants from a part, then the whole, in turns
"""
