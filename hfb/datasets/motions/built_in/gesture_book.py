"""The key poses of the built-in movements, in the words that `hfb.datasets.motions.built_in.gestures` explains.

A movement has a name, the length of a cycle, and its key poses: the relative time until the next one, and the angles
[deg] that differ from standing. `mirrored`: the second half of the cycle is the first with left and right exchanged.
`turning`: degrees that the body has turned to its left after a cycle. A limb's word without l_ or r_ means both.
"""

STANCES = """
stand | hip 6, out 3, knee 10, toes 4, arm 4, wide 14, elbow 18, nod 4
guard | l_arm 48, wide 8, l_elbow 108, r_arm 42, r_elbow 118, l_hip 22, knee 24, r_hip -6, r_toes -6, bend 10,
        twist -18, nod 6, yaw -14
crouch | hip 46, knee 72, toes 22, bend 26, pitch 14
"""
"""Base poses of the other poses; guard and crouch are themselves changes of standing."""

MOVEMENTS = """
walk: 1.05 s, mirrored
  1 | l_hip 26, l_knee 2, l_toes 8, r_hip -22, r_knee 12, r_toes -12, l_arm -26, r_arm 26, twist -8, yaw 4,
        r_elbow 32
  1 | l_hip 12, l_knee 12, l_toes 2, r_hip 2, r_knee 52, r_toes -10, l_arm -8, r_arm 8, roll -3
  1 | l_hip -6, l_knee 4, l_toes 8, r_hip 30, r_knee 48, r_toes 6, l_arm 14, r_arm -14, roll -2, twist 4
stride: 0.86 s, mirrored
  1 | l_hip 38, l_knee 4, l_toes 12, r_hip -28, r_knee 16, r_toes -22, l_arm -42, r_arm 48, twist -14, yaw 7,
        bend 6, r_elbow 52
  1 | l_hip 18, l_knee 22, r_hip 8, r_knee 72, r_toes -14, bend 6, roll -4, elbow 40
  1 | l_hip -8, l_knee 8, r_hip 42, r_knee 58, l_arm 26, r_arm -24, bend 6, twist 8
run: 0.68 s, mirrored
  1 | l_hip 34, l_knee 24, l_toes 8, r_hip -14, r_knee 62, r_toes -24, l_arm -46, r_arm 40, l_elbow 84, r_elbow 92,
        bend 12, twist -10
  1 | l_hip 10, l_knee 34, l_toes 14, r_hip 26, r_knee 104, r_toes -20, l_arm -8, r_arm 6, elbow 84, bend 14
  1 | l_hip -22, l_knee 14, l_toes -26, r_hip 58, r_knee 74, l_arm 38, r_arm -42, l_elbow 96, r_elbow 80, bend 12,
        twist 10, hop 0.05
sprint: 0.52 s, mirrored
  1 | l_hip 36, l_knee 22, r_hip -4, r_knee 92, r_toes -28, l_arm -50, r_arm 72, l_elbow 78, r_elbow 98, bend 20,
        twist -16
  1 | l_hip 6, l_knee 26, l_toes 10, r_hip 50, r_knee 118, r_toes -14, elbow 88, bend 20
  1 | l_hip -24, l_knee 10, l_toes -34, r_hip 84, r_knee 92, l_arm 68, r_arm -48, l_elbow 100, r_elbow 78, bend 18,
        twist 14, hop 0.09
knee lifts: 0.8 s, mirrored
  1 | l_hip 96, l_knee 104, l_toes -10, r_arm 62, l_arm -34, r_elbow 84, l_elbow 74, bend 6, twist 12, hop 0.05
  1 | l_hip 40, l_knee 52, r_hip 14, r_knee 26, elbow 66
skip: 0.95 s, mirrored
  1.2 | l_hip 72, l_knee 88, r_hip -10, r_toes -34, r_arm 92, l_arm -40, r_elbow 50, l_elbow 40, hop 0.2, twist 12
  1 | l_hip 30, l_knee 28, r_hip -4, r_knee 30, bend 10
  0.8 | l_hip 16, l_knee 36, r_hip 10, r_knee 50, bend 10, l_arm 16
jump: 1.45 s
  1.2 | stand
  1.1 | crouch, arm -36
  0.7 | hip -6, knee 0, toes -36, arm 112, bend -6, hop 0.05
  0.9 | hip 12, knee 22, toes -30, arm 144, bend -6, hop 0.42
  0.9 | hip 20, knee 26, arm 96, toes -16, hop 0.03
  1.2 | crouch, arm 34
tuck jump: 1.2 s
  1 | crouch, arm -40
  0.7 | knee 2, toes -34, arm 110, hop 0.06
  0.9 | l_hip 100, r_hip 96, l_knee 116, r_knee 112, bend 22, arm 66, elbow 50, hop 0.6
  0.8 | hip 24, knee 26, toes -12, hop 0.03, wide 60
jumping jack: 0.92 s
  1 | wide 8, knee 16, hip 8
  0.8 | out 14, wide 76, hop 0.12, toes -24
  1 | out 28, wide 142, knee 14, elbow 12
  0.8 | out 14, wide 84, hop 0.12, toes -24
front kick: 1.3 s
  1.2 | guard
  0.8 | l_arm 48, wide 8, l_elbow 108, r_arm -10, r_elbow 60, l_hip 8, l_knee 16, r_hip 78, r_knee 112, r_toes -6,
        bend 4, twist 8, nod 6, yaw -14
  0.5 | l_arm 60, wide 8, l_elbow 108, r_arm -30, r_elbow 40, l_hip 0, l_knee 14, r_hip 92, r_knee 8, r_toes -18,
        bend -2, twist 14, nod 6, yaw -14, l_toes -6, pitch -14
  0.7 | guard, r_elbow 70, l_hip 8, l_knee 16, r_hip 74, r_knee 104, bend 4
roundhouse kick: 1.45 s
  1.2 | guard
  0.7 | guard, l_hip 4, l_knee 14, r_hip 50, r_knee 118, twist -24, yaw 26, r_out 42, roll 18, lean 12
  0.5 | l_arm 30, l_wide 8, l_elbow 108, r_arm -36, r_wide 46, r_elbow 30, l_hip 0, l_knee 10, r_hip 66, r_knee 12,
        r_toes -30, bend 10, twist -34, nod 6, yaw 92, r_out 52, l_toes -14, roll 32, lean 14
  0.7 | guard, l_hip 4, l_knee 16, r_hip 58, r_knee 104, twist -20, yaw 60, r_out 36, roll 20, lean 8
side kick: 1.4 s
  1.2 | guard, yaw -40
  0.7 | guard, l_hip 76, l_knee 116, r_hip 4, r_knee 16, yaw -60, l_out 14, roll -10, lean -8
  0.5 | l_arm 10, l_wide 40, l_elbow 40, r_arm 42, r_wide 8, r_elbow 118, l_hip 34, l_knee 6, r_hip 2, r_knee 10,
        r_toes -6, bend 10, twist -18, nod 6, yaw -84, l_out 55, l_toes 18, roll -34, lean -12
  0.8 | guard, l_hip 70, l_knee 100, r_hip 6, r_knee 20, yaw -56, l_out 20, roll -8
ball kick: 1.25 s
  1 | l_hip 16, l_knee 18, r_hip -24, r_knee 84, r_toes -30, l_arm 56, l_wide 50, r_arm -30, twist 22, bend 2,
        yaw -16
  0.6 | l_hip 8, l_knee 22, r_hip 18, r_knee 58, r_toes -36, l_arm 20, l_wide 50, bend 12
  0.6 | l_hip 0, knee 12, l_toes -10, r_hip 84, r_toes -34, l_arm -40, r_arm 44, twist -26, bend 16, pitch -10,
        yaw 14
  1.3 | r_hip 34, r_knee 34, l_hip 4, bend 8
punches: 0.78 s
  1 | guard
  0.55 | l_arm 88, l_wide 0, l_elbow 6, r_arm 42, r_wide 8, r_elbow 118, l_hip 28, l_knee 32, r_hip -6, r_knee 24,
        r_toes -6, bend 14, twist -36, nod 6, yaw -24, l_palm 40
  0.8 | guard
  0.55 | l_arm 48, l_wide 8, l_elbow 108, r_arm 88, r_wide -6, r_elbow 6, l_hip 22, l_knee 24, r_hip -6, r_knee 34,
        r_toes -22, bend 14, twist 34, nod 6, yaw 16, r_palm 40
hook and uppercut: 1 s
  1 | guard
  0.6 | guard, r_arm 48, r_wide 82, r_elbow 92, twist -34, yaw -26, r_spin -10
  0.6 | guard, r_arm 92, r_wide 10, r_elbow 88, r_toes -20, twist 44, yaw 20
  0.8 | l_arm -6, l_wide 22, l_elbow 84, r_arm 42, r_wide 8, r_elbow 118, l_hip 40, l_knee 54, r_hip 20, r_knee 48,
        r_toes -6, bend 10, twist 20, nod 6, yaw -14, lean 14
  0.6 | l_arm 112, wide 8, l_elbow 96, r_arm 42, r_elbow 118, l_hip 8, knee 12, r_hip -4, r_toes -6, bend 0,
        twist -30, nod 6, yaw -14
overhead throw: 1.5 s
  1.2 | r_arm 60, r_elbow 96, l_arm 40, l_elbow 80, yaw -24, l_hip 16
  0.9 | r_arm 60, r_wide 92, r_elbow 96, r_spin -40, l_arm 74, l_wide 30, l_elbow 20, twist -36, yaw -42, bend -12,
        l_hip 56, l_knee 58, r_hip 10, r_knee 34
  0.5 | r_arm 132, r_wide 42, r_elbow 64, l_arm 30, l_elbow 74, twist 6, yaw -8, l_hip 40, knee 24, r_hip -14,
        r_toes -20
  0.6 | r_arm 56, r_wide -12, r_elbow 14, l_arm -24, l_elbow 70, twist 42, yaw 14, bend 36, l_hip 48, l_knee 36,
        r_hip -20, r_knee 40, r_toes -30
  1 | r_arm 20, bend 16, l_hip 24, l_knee 26, twist 12
underarm throw: 1.3 s
  1 | r_arm 30, r_elbow 30, l_hip 14
  0.8 | r_arm -50, r_elbow 10, l_hip 46, l_knee 46, r_hip -8, r_knee 40, r_toes -14, bend 24, twist -20, l_arm 40
  0.6 | r_arm 104, r_elbow 22, l_hip 30, knee 30, r_hip -16, r_toes -26, bend 8, twist 22, l_arm -26, hop 0.02
squat: 1.6 s
  1 | arm 20
  1 | hip 84, knee 104, out 16, turn 14, toes 26, bend 24, pitch 12, arm 84, nod -12
squat jump: 1.1 s
  1 | hip 70, knee 92, toes 22, bend 26, pitch 14, arm -20
  0.6 | knee 2, toes -36, wide 60, hop 0.08
  0.8 | out 30, wide 110, knee 24, hop 0.4
  0.7 | hip 24, knee 30, toes -14, hop 0.03
lunges: 1.25 s, mirrored
  1 | l_hip 74, l_knee 84, l_toes 14, r_hip -12, r_knee 76, r_toes -24, r_arm 46, l_arm -30, r_elbow 70, l_elbow 50,
        bend 4
  1 | l_hip 34, l_knee 34, r_hip 14, r_knee 44, elbow 50
spin: 1.2 s, turning 360
  1 | wide 82, l_hip 8, r_hip 34, r_knee 74, l_toes -20, twist 20, r_out 20
  1 | wide 40, arm 40, elbow 70, r_hip 40, r_knee 88, l_toes -26, r_out 26
  1 | wide 76, twist -14, l_knee 22, r_knee 26
turn on the spot: 1.3 s, turning 180
  1 | l_hip 14, l_knee 20, twist 30, look 30, l_arm -20, r_arm 30
  1 | r_hip 34, r_knee 52, r_out 10, twist 8, l_arm 10, r_arm 8
  1 | l_hip 30, l_knee 46, l_out 14, twist -6, r_arm -18, l_arm 24
side step: 1.05 s
  1 | l_out 26, r_out 14, l_hip 26, l_knee 36, r_hip 20, r_knee 28, l_wide 46, r_wide 40, elbow 50, bend 12
  0.8 | out 2, l_hip 18, l_knee 26, r_hip 30, r_knee 54, wide 20, arm 30, elbow 80, hop 0.04, bend 8
speed skater: 1.1 s, mirrored
  1 | l_hip 48, l_knee 62, l_toes 16, r_hip -12, r_out 40, r_knee 36, r_toes -14, bend 36, twist 22, r_arm 62,
        l_arm -46, l_wide 40, roll -8, r_elbow 40
  0.8 | hip 26, knee 34, hop 0.12, bend 24, wide 50
arm swing: 0.95 s, mirrored
  1 | l_arm 110, r_arm -46, elbow 10, twist -14, knee 18, hip 12
  1 | arm 20, wide 22, knee 26, hip 16
wide swing: 1.15 s
  1 | wide 96, twist 0, l_arm 0, bend -8, out 10
  0.9 | l_arm 76, r_arm 80, l_wide -24, r_wide -20, l_elbow 30, r_elbow 26, bend 12, out 10, knee 24, hip 14
chop: 1.2 s
  1 | arm 138, wide 16, elbow 40, bend -12, toes -8, out 12
  0.6 | arm 96, wide 0, elbow 14, bend 30, knee 36, hip 30, out 12
  0.8 | arm 30, wide 2, bend 62, pitch 14, knee 56, hip 44, toes 16, out 12
golf swing: 1.5 s
  1 | bend 30, pitch 10, arm 40, wide -4, knee 24, hip 20, out 12
  1 | bend 26, pitch 8, twist -48, yaw -34, l_arm 92, l_wide -32, r_arm 70, r_wide 40, r_elbow 92, l_knee 34,
        r_knee 18, l_hip 20, r_hip 16, out 12
  0.5 | bend 30, pitch 10, twist 6, yaw 12, l_arm 38, r_arm 46, l_wide 0, r_wide -6, l_knee 16, r_knee 30, l_hip 18,
        r_hip 20, out 12
  0.8 | bend 0, twist 50, yaw 58, l_arm 84, l_wide 40, l_elbow 94, r_arm 108, r_wide -30, r_elbow 30, r_hip -8,
        r_knee 40, r_toes -36, l_knee 8, l_out 12, r_out 8
forehand: 1.15 s
  1 | twist -40, yaw -40, r_arm 0, r_wide 84, elbow 30, l_arm 60, l_hip 26, l_knee 32, r_hip 20, r_knee 36, out 14
  0.5 | twist 6, yaw 0, r_arm 56, r_wide 48, r_elbow 24, l_arm 30, l_wide 46, l_elbow 60, l_hip 26, l_knee 26,
        r_knee 36, out 14
  0.8 | twist 44, yaw 32, r_arm 106, r_wide -28, r_elbow 84, l_wide 50, l_elbow 60, r_hip -6, r_knee 40, r_toes -26,
        l_hip 14, out 14
disco: 0.96 s
  1 | r_arm 80, r_wide 88, r_elbow 8, l_arm 10, l_wide 44, l_elbow 92, lean 16, roll 8, l_knee 34, l_hip 22,
        r_out 18, twist 14, look 20
  1 | r_arm 36, r_wide -16, r_elbow 20, l_wide 40, l_elbow 92, lean -14, roll -8, r_knee 34, r_hip 22, l_out 16,
        bend 16, twist 28, look -14
groove: 1 s, mirrored
  1 | l_hip 34, l_knee 50, r_knee 22, r_hip 10, lean 18, roll 8, l_arm 46, l_elbow 94, r_arm -20, r_wide 34,
        r_elbow 64, twist 18, tilt 10
  1 | knee 30, hip 22, bend 20, arm 24, wide 60, elbow 70, nod 20
twist dance: 0.8 s, mirrored
  1 | twist 40, yaw -26, knee 44, hip 30, l_arm 34, r_arm -16, elbow 84, wide 30, bend 12
  1 | knee 58, hip 38, elbow 84, bend 14
charleston: 0.9 s
  1 | l_hip 62, l_knee 20, r_knee 22, r_hip 10, r_arm 64, l_arm -42, elbow 24, bend 10, hop 0.02
  1 | l_hip 10, l_knee 20, r_hip 12, r_knee 26, bend 12, wide 36
  1 | l_hip -18, l_knee 66, l_toes -24, r_hip 16, r_knee 26, r_arm -38, l_arm 60, bend 18, hop 0.02
  1 | l_hip 10, l_knee 34, r_hip 12, r_knee 26, bend 12, wide 36
overhead wave: 1 s, mirrored
  1 | l_wide 126, r_wide 110, lean 20, roll 6, l_arm 20, r_arm 30, r_knee 26, r_hip 16, l_elbow 22, r_elbow 46,
        tilt 10
  0.6 | wide 132, knee 20, hip 12
reach and pick: 1.9 s
  1 | r_arm 140, r_wide 20, r_elbow 8, l_toes -20, r_toes -24, lean -8, nod -24
  1.2 | l_hip 72, r_hip 66, l_knee 82, r_knee 80, l_toes 24, r_toes 20, bend 48, pitch 22, r_arm 60, l_arm 40,
        out 10, twist 10
  0.8 | arm 60, elbow 70, twist 20
leg swing: 1 s
  1 | r_hip 72, r_knee 10, r_toes -14, l_arm 60, r_arm -40, l_knee 12, pitch -8
  1 | r_hip -22, r_knee 36, r_toes -24, l_arm -40, r_arm 50, l_knee 14, pitch 12, bend 10
hop on one leg: 0.62 s
  1 | r_hip 40, r_knee 92, r_toes -20, l_hip 28, l_knee 46, l_toes 14, wide 44, bend 16
  0.8 | r_hip 52, r_knee 84, r_toes -24, l_hip 2, l_knee 8, l_toes -30, wide 76, elbow 30, hop 0.14
"""
