"""Change the crane, add Exudyn objects of your own, let Exudyn solve: the boom lifts while an elastic rope holds its
tip.

python examples/own_model.py [FOLDER]     # writes rope.png there
"""

import sys
from pathlib import Path

import exudyn.itemInterface as ei
import numpy as np
from exudyn import OutputVariableType as Output
from exudyn.graphics import Cylinder

from crane_exudyn import Crane, ExudynEngine, mechanism
from crane_exudyn.geometry import pose
from crane_exudyn.render import Scene, Trajectory

folder = Path(sys.argv[1] if len(sys.argv) > 1 else ".")
folder.mkdir(parents=True, exist_ok=True)
crane = Crane.load("patu655").with_parameters({"payload.mass": 60.0, "joints.E.x": 2.4})  # a longer extension
start = ExudynEngine(crane).static_start(np.radians(20.0), np.radians(-50.0))
_, mbs = mechanism.main_system()
plant = mechanism.build(mbs, crane, states=start, inputs=lambda t: np.array([0.3 * (t > 0.2), 0, np.nan, np.nan]))

stump, tip = np.array([4.2, 0.0, 0.0]), np.append(pose(crane, *start[:2]).points["E"][0], 0.0)
top = plant.marker("E")
foot = mbs.AddMarker(ei.MarkerBodyPosition(bodyNumber=mbs.AddObject(ei.ObjectGround(referencePosition=stump))))
spring = {"referenceLength": np.linalg.norm(tip - stump), "stiffness": 2e4, "damping": 5e2}
rope = mbs.AddObject(ei.ObjectConnectorSpringDamper(markerNumbers=[foot, top], **spring))
mbs.Assemble()
mbs.SolveDynamic(mechanism.settings(step=2e-3, duration=1.5))

z1, outer = (mbs.GetNodeOutput(plant.nodes[0][b], Output.Coordinates)[2] for b in ("lift_boom", "outer_boom"))
force = np.linalg.norm(mbs.GetObjectOutput(rope, Output.Force))
print(f"The rope pulls with {force:.0f} N; z1 went from {np.degrees(start[0]):.1f} to {np.degrees(z1):.1f} deg.")
end = Trajectory("end", np.array([0.0, 1.5]), np.array([start[:2], [z1, outer - z1]]))
line = np.append(pose(crane, z1, outer - z1).points["E"][0], 0.0) - stump
look = ei.VObjectGround(graphicsData=[Cylinder(stump, line, 0.02, color=[0.1, 0.3, 0.1, 1.0])])
scene = Scene(crane, [end], title="Held by a rope", own=lambda m: m.AddObject(ei.ObjectGround(visualization=look)))
scene.save(folder / "rope.png")
