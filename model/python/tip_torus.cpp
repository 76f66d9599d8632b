// Equilibria without clearance and friction, by the torus of the angles at the tips.
#include "ctr/tip_torus.hpp"

#include "arrays.hpp"
#include "bindings.hpp"
#include "unlocked.hpp"

namespace {

using Values = std::vector<double>;

ctr::TorusTubes make(Values EI, Values GJ, Values behind, const Values& begin, const Values& end, const std::vector<int>& first,
                     const Tensor& u, const Tensor& slope) {
    const std::size_t n = EI.size();
    if (n < 1 || n > ctr::TORUS_MOST_TUBES || GJ.size() != n || behind.size() != n)
        throw ctr::InvalidInput("equilibria are enumerated of one to five tubes");
    if (end.size() != begin.size() || first.size() != begin.size()) throw ctr::InvalidInput("stretches differ in number");
    for (const Tensor* part : {&u, &slope})
        if (part->shape(0) != begin.size() || part->shape(1) != n || part->shape(2) != 2)
            throw ctr::InvalidInput("precurvatures are (stretches, tubes, 2)");
    ctr::TorusTubes tubes{std::move(EI), std::move(GJ), std::move(behind), {}};
    for (std::size_t k = 0; k < begin.size(); ++k) {
        const double *at = u.data() + 2 * n * k, *by = slope.data() + 2 * n * k;
        tubes.stretches.push_back({begin[k], end[k], first[k], Values(at, at + 2 * n), Values(by, by + 2 * n)});
    }
    return tubes;
}

Values flat(const Matrix& psi, const ctr::TorusTubes& tubes) {
    if (psi.shape(1) + 1 != tubes.EI.size()) throw ctr::InvalidInput("angles at the tips are (starts, pairs)");
    return Values(psi.data(), psi.data() + psi.size());
}

nb::object signs(const ctr::TorusTubes& tubes, const Matrix& psi, double step) {
    const std::vector<int> signs = ctr::torus_signs(tubes, flat(psi, tubes), step);
    return hand_over<std::int64_t>(std::vector<std::int64_t>(signs.begin(), signs.end()), {signs.size()});
}

// For each row of alpha a list, with a tuple of each root: angles at the tips, twist, sign, whether it is stable, energy, tip.
nb::list roots(const ctr::TorusTubes& tubes, const Matrix& psi, const Matrix& alpha, const Values& outermost, double reach, double apart,
               double step) {
    if (alpha.shape(1) + 1 != tubes.EI.size() || alpha.shape(0) != outermost.size())
        throw ctr::InvalidInput("relative angles of the collars are (configurations, pairs)");
    nb::list all;
    for (std::vector<ctr::TorusRoot>& each : ctr::torus_roots(tubes, flat(psi, tubes), flat(alpha, tubes), outermost, reach, apart, step)) {
        nb::list made;
        for (ctr::TorusRoot& root : each)
            made.append(nb::make_tuple(array(std::move(root.psi)), array(std::move(root.twist)), root.sign, root.is_stable, root.energy,
                                       array(Values(root.tip, root.tip + 3))));
        all.append(made);
    }
    return all;
}

// Arc lengths (K,), and angles (G, n, K) where the tips stand at psi (G, n - 1).
nb::tuple shapes(const ctr::TorusTubes& tubes, const Matrix& psi, const Values& outermost, double step) {
    if (psi.shape(0) != outermost.size()) throw ctr::InvalidInput("angles of the outermost collar are (shapes,)");
    ctr::TorusShapes made = ctr::torus_shapes(tubes, flat(psi, tubes), outermost, step);
    const std::size_t count = made.s.size();
    return nb::make_tuple(array(std::move(made.s)), array(std::move(made.theta), {psi.shape(0), tubes.EI.size(), count}));
}

}  // namespace

void bind_tip_torus(nb::module_& m) {
    nb::class_<ctr::TorusTubes>(m, "TorusTubes")
        .def("__init__", [](ctr::TorusTubes* self, Values EI, Values GJ, Values behind, const Values& begin, const Values& end,
                            const std::vector<int>& first, const Tensor& u, const Tensor& slope) {
            new (self) ctr::TorusTubes(make(std::move(EI), std::move(GJ), std::move(behind), begin, end, first, u, slope));
        }, nb::kw_only(), "EI"_a, "GJ"_a, "behind"_a, "begin"_a, "end"_a, "first"_a, "u"_a.noconvert(), "slope"_a.noconvert())
        .def("signs", &signs, "psi"_a.noconvert(), "step"_a)
        .def("roots", &roots, "psi"_a.noconvert(), "alpha"_a.noconvert(), "outermost"_a, "reach"_a, "apart"_a, "step"_a)
        .def("shapes", &shapes, "psi"_a.noconvert(), "outermost"_a, "step"_a);
}
