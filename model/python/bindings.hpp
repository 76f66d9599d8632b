// One function per file that binds a class, or the records it is made of.
#pragma once

#include <nanobind/nanobind.h>

void bind_equilibrium(nanobind::module_& m);
void bind_robot(nanobind::module_& m);
void bind_walk(nanobind::module_& m);
void bind_history(nanobind::module_& m);
void bind_shape(nanobind::module_& m);
void bind_model(nanobind::module_& m);
void bind_walker(nanobind::module_& m);
void bind_triangle_tree(nanobind::module_& m);
void bind_friction_states(nanobind::module_& m);
void bind_friction_cells(nanobind::module_& m);
void bind_tip_torus(nanobind::module_& m);
