#!/usr/bin/env bash
# UsdSkel: scales of an animation are numbers of 16 bits, so a body's size moves in steps of a thousandth; rotations and places are float32.
#
# Guess (2026-11-28): a scale of 1.003 is kept to 1e-6, as translations and rotations are.
# Seen with usd-core 26.11: 1.003 is read as 1.00293, 1.0004 as 1. `UsdSkel.Animation` has no other type for scales.
# So: a person's size belongs into the rest pose and the points, not into animated scales (1.0004 of 1.8 m is .7 mm).
set -euo pipefail
place=$(mktemp -d); trap 'rm -rf "$place"' EXIT
python3 -m venv "$place/venv"
"$place/venv/bin/pip" install --quiet --no-compile --disable-pip-version-check usd-core==26.11
"$place/venv/bin/python" - <<'PY'
from pxr import Gf, Usd, UsdSkel

stage = Usd.Stage.CreateInMemory()
root = UsdSkel.Root.Define(stage, "/body")
skeleton, animation = UsdSkel.Skeleton.Define(stage, "/body/skeleton"), UsdSkel.Animation.Define(stage, "/body/animation")
for target in (skeleton, animation):
    target.CreateJointsAttr(["hips"])
skeleton.CreateBindTransformsAttr([Gf.Matrix4d(1)])
skeleton.CreateRestTransformsAttr([Gf.Matrix4d(1)])
UsdSkel.BindingAPI.Apply(skeleton.GetPrim()).CreateAnimationSourceRel().SetTargets(["/body/animation"])
animation.CreateRotationsAttr([Gf.Quatf(1)])
animation.CreateTranslationsAttr([Gf.Vec3f(1.003)])
found = {}
for scale in (1.003, 1.0004):
    animation.CreateScalesAttr([Gf.Vec3h(scale)])
    cache = UsdSkel.Cache()
    cache.Populate(root, Usd.PrimDefaultPredicate)
    transform = cache.GetSkelQuery(skeleton).ComputeJointLocalTransforms(Usd.TimeCode.Default())[0]
    found[scale] = transform[0][0], transform[3][0]
print("asked: (scale, place of 1.003):", found)
assert abs(found[1.003][0] - 1.0029297) < 1e-6 and found[1.0004][0] == 1, found
assert all(abs(place - 1.003) < 1e-6 for _, place in found.values()), found
assert animation.GetScalesAttr().GetTypeName() == "half3[]"
print(f"USD {'.'.join(map(str, Usd.GetVersion()))}: as found")
PY
