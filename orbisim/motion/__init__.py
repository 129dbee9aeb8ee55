"""A recorded motion along a scene, before anything is fitted or decided.

`samples` smooths a recording to a reference motion and says how measurements deviate from it;
`hidden` adds the states that no sensor shows; `linear` linearizes the scene's map over every
sampling interval; `regressors` has the model's quantities that effects turn into columns of a
regression; `force` has the generalized force that is missing, by inverse dynamics. Whatever takes
a Recording and a Scene and looks for what the scene lacks begins here.
"""
