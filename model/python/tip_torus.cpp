// Equilibria without clearance and friction, by the torus of the angles at the tips.
#include "ctr/tip_torus.hpp"

#include "arrays.hpp"
#include "bindings.hpp"
#include "unlocked.hpp"

namespace {

using Values = std::vector<double>;

struct Torus {
    std::size_t n;
    std::unique_ptr<ctr::TipTorus> of;
};

Torus make(Values EI, Values GJ, Values behind, const Values& begin, const Values& end, const std::vector<int>& first, const Tensor& u,
           const Tensor& slope, double step) {
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
    return {n, ctr::TipTorus::of(std::move(tubes), step)};
}

Values flat(const Matrix& angles, const Values& outermost, const Torus& torus) {
    if (angles.shape(1) + 1 != torus.n || angles.shape(0) != outermost.size())
        throw ctr::InvalidInput("relative angles are (configurations, pairs), those of the outermost collar (configurations,)");
    return Values(angles.data(), angles.data() + angles.size());
}

nb::tuple map(Torus& torus, int count) {
    ctr::TorusMap made = unlocked([&] { return torus.of->map(count); });
    const std::size_t places = made.det.size();
    return nb::make_tuple(array(std::move(made.R), {places, torus.n - 1}), array(std::move(made.det)));
}

// For each row of alpha a list, with a tuple of each root: angles at the tips, twist, sign, whether it is stable, energy, tip.
nb::list roots(Torus& torus, int count, const Matrix& alpha, const Values& outermost, double reach, double apart) {
    const Values angles = flat(alpha, outermost, torus);
    std::vector<std::vector<ctr::TorusRoot>> found = unlocked([&] { return torus.of->roots(count, angles, outermost, reach, apart); });
    nb::list all;
    for (std::vector<ctr::TorusRoot>& each : found) {
        nb::list made;
        for (ctr::TorusRoot& root : each)
            made.append(nb::make_tuple(array(std::move(root.psi)), array(std::move(root.twist)), root.sign, root.is_stable, root.energy,
                                       array(Values(root.tip, root.tip + 3))));
        all.append(made);
    }
    return all;
}

// Arc lengths (K,), and angles (G, n, K) where the tips stand at psi (G, n - 1).
nb::tuple shapes(const Torus& torus, const Matrix& psi, const Values& outermost) {
    ctr::TorusShapes made = torus.of->shapes(flat(psi, outermost, torus), outermost);
    const std::size_t count = made.s.size();
    return nb::make_tuple(array(std::move(made.s)), array(std::move(made.theta), {psi.shape(0), torus.n, count}));
}

}  // namespace

void bind_tip_torus(nb::module_& m) {
    nb::class_<Torus>(m, "TipTorus")
        .def("__init__", [](Torus* self, Values EI, Values GJ, Values behind, const Values& begin, const Values& end,
                            const std::vector<int>& first, const Tensor& u, const Tensor& slope, double step) {
            new (self) Torus(make(std::move(EI), std::move(GJ), std::move(behind), begin, end, first, u, slope, step));
        }, nb::kw_only(), "EI"_a, "GJ"_a, "behind"_a, "begin"_a, "end"_a, "first"_a, "u"_a.noconvert(), "slope"_a.noconvert(), "step"_a)
        .def("map", &map, "count"_a)
        .def("roots", &roots, "count"_a, "alpha"_a.noconvert(), "outermost"_a, "reach"_a, "apart"_a)
        .def("shapes", &shapes, "psi"_a.noconvert(), "outermost"_a);
}
