"""The same episodes through two backends: how far apart are they, and is that rounding?"""

from orbisim.compare import compare

result = compare("suite:pendulum-swingup", "mujoco", "learned", count=4, horizon=1.0, seed=0)
summary = result.to_json()
for group, error in summary["error"].items():
    for share in (0, -1):
        when = summary["horizon_s"][share]
        print(f"{group} at {when:.2g} s: median {error['median'][share]:.2g} {error['unit']}")
    floor = summary["rounding"][group]["median"][-1]
    print(f"{group}: float32 rounding alone gives {floor:.2g} {error['unit']} at the end")
print(result.report("out/compare", video=False))  # one HTML file
