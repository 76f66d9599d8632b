// The thin Python face of the core: arrays in, arrays and plain dictionaries out. ctrplan/mechanics/core.py is its only user.
#include <cstdlib>

#include "ctr/kernel.hpp"
#include "model.hpp"

NB_MODULE(_model, m) {
    m.doc() = "Mechanics of concentric tube robots with clearance and friction (C++ core of ctrplan)";
    // Somebody who still holds a robot when Python ends is told so only if they ask; the tests do.
    nb::set_leak_warnings(std::getenv("CTRPLAN_LEAK_WARNINGS") != nullptr);
    nb::exception<ctr::InvalidInput>(m, "InvalidInput", PyExc_ValueError);
    m.def("kernel_name", &ctr::kernel_name, "instruction set of the kernel in use");
    nb::class_<ctr::History::State>(m, "HistoryState");
    nb::class_<PathHistory>(m, "History")
        .def("start", &PathHistory::start, "theta_b"_a.noconvert(), "l_b"_a.noconvert(), "phi"_a.noconvert())
        .def("advance", &PathHistory::advance, "theta_b"_a.noconvert(), "l_b"_a.noconvert())
        .def("follow", &PathHistory::follow, "theta_b"_a.noconvert(), "l_b"_a.noconvert())
        .def("shape", &PathHistory::shape)
        .def("friction", &PathHistory::friction)
        .def("beside", &PathHistory::beside, "phi"_a.noconvert())
        .def("save", &PathHistory::save)
        .def("restore", &PathHistory::restore, "state"_a);
    nb::class_<FieldLookup>(m, "FieldLookup")
        .def("sample", &FieldLookup::sample, "theta_b"_a.noconvert(), "l_b"_a.noconvert())
        .def("check_path", &FieldLookup::check_path, "theta_b"_a.noconvert(), "l_b"_a.noconvert(), "field"_a.none(), "origin"_a.noconvert(),
             "spacing"_a, "R_AB"_a.noconvert(), "p_AB"_a.noconvert(), "density"_a.noconvert(), "limits"_a.noconvert());
    nb::class_<Model>(m, "Model")
        .def(nb::init<const std::vector<std::vector<double>>&, const std::vector<std::vector<std::vector<double>>>&,
                      const std::vector<std::vector<double>>&, const std::vector<std::vector<double>>&>(),
             "tubes"_a, "sections"_a, "pairs"_a, "loads"_a)
        .def("zero_clearance", &Model::zero_clearance, "theta_b"_a.noconvert(), "l_b"_a.noconvert())
        .def("solve", &Model::solve, "theta_b"_a.noconvert(), "l_b"_a.noconvert(), "phi"_a.noconvert(), "level"_a,
             "refinement"_a)
        .def("bound", &Model::bound, "theta_b"_a.noconvert(), "l_b"_a.noconvert(), "level"_a)
        .def("bound_many", &Model::bound_many, "theta_b"_a.noconvert(), "l_b"_a.noconvert(), "level"_a, "threads"_a)
        .def("tips", &Model::tips, "theta_b"_a.noconvert(), "l_b"_a.noconvert(), "threads"_a)
        .def("rooms", &Model::rooms, "theta_b"_a.noconvert(), "l_b"_a.noconvert(), "field"_a.none(), "origin"_a.noconvert(),
             "spacing"_a, "R_AB"_a.noconvert(), "p_AB"_a.noconvert(), "step"_a, "threads"_a)
        .def("field_entries", &Model::field_entries, "theta_b"_a.noconvert(), "l_b"_a.noconvert(), "threads"_a)
        .def("field_lookup", &Model::field_lookup, "axes"_a, "values"_a.noconvert(), "margin"_a)
        .def("history", &Model::history, "level"_a, "breakaway"_a, "rotation"_a, "translation"_a, "state_change"_a)
        .def("number_names", &Model::number_names)
        .def("tips_with_friction", &Model::tips_with_friction, "theta_b"_a.noconvert(), "l_b"_a.noconvert(), "phi"_a.noconvert(),
             "directions"_a, "level"_a, "threads"_a)
        .def("check_path", &Model::check_path, "theta_b"_a.noconvert(), "l_b"_a.noconvert(), "field"_a.none(),
             "origin"_a.noconvert(), "spacing"_a, "R_AB"_a.noconvert(), "p_AB"_a.noconvert(), "density"_a.noconvert(),
             "limits"_a.noconvert(), "level"_a, "bodies"_a)
        .def("body", &Model::body, "theta_b"_a.noconvert(), "l_b"_a.noconvert(), "level"_a);
}
