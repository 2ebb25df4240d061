"""Where random numbers come from (`sobol`, `random`) and the shapes they are warped to (`warp`)."""
