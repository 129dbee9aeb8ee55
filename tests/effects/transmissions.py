"""Actuators of every transmission, for tests of units."""

import mujoco

TRANSMISSIONS = mujoco.MjModel.from_xml_string("""
<mujoco>
  <worldbody>
    <body name="cart">
      <joint name="slide" type="slide" axis="1 0 0"/><geom size=".1"/>
      <body name="pole"><joint name="hinge" axis="0 1 0"/><geom size=".1"/>
        <site name="tip" pos="0 0 1"/></body>
    </body>
    <body name="drone"><freejoint name="free"/><geom size=".1"/><site name="hub"/></body>
  </worldbody>
  <tendon>
    <fixed name="angle"><joint joint="hinge" coef="1"/></fixed>
    <fixed name="mixed"><joint joint="hinge" coef="1"/><joint joint="slide" coef="1"/></fixed>
    <spatial name="cable"><site site="tip"/><site site="hub"/></spatial>
  </tendon>
  <actuator>
    <motor name="hinge" joint="hinge"/>
    <motor name="slide" joint="slide"/>
    <motor name="angle" tendon="angle"/>
    <motor name="mixed" tendon="mixed"/>
    <motor name="cable" tendon="cable"/>
    <motor name="rotor" site="hub" gear="0 0 1 0 0 0.1"/>
    <motor name="wheel" site="hub" gear="0 0 0 0 0 1"/>
    <motor name="spin" joint="free" gear="0 0 0 1 0 0"/>
  </actuator>
</mujoco>
""")
