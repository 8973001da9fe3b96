"""A ROS 2 node for tactile-loc: it receives images of the gel, and publishes poses with covariances."""
