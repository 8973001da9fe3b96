"""Images that come one after the other: cameras, videos, recordings and ROS messages."""
