"""`tactile-loc doctor` and its checks of this machine, the installed libraries, the plugins and the store."""
