"""A ROS 2 node for tactile-loc: images of the gel in, poses with covariance out."""
