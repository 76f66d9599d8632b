#include "ctr/mesh.hpp"

#include <algorithm>
#include <cmath>

namespace ctr {
namespace {

#include "element_functions.hpp"

// Breaks closer than this become one: shorter elements would only cost digits (their stiffness goes with 1 / length^3).
constexpr double kMergeDistance = 1e-5;

// Shafts stiffer than this would only cost digits: they turn by less than 1e-8 rad.
constexpr double kRigidShaft = 1e-7;  // rad / (N m)

// A single tube carries no contact. In front it is an arc, whose elements serve interpolation along it; behind the outermost
// collar it bends between its collar and the next, exactly so in one element where it is straight.
constexpr double kSingleTubeLength = 10e-3;
constexpr double kStraightLength = 40e-3;

// A number for the k-th collar, joint or tip; sums of them tell sets apart (the finaliser of SplitMix64).
std::uint64_t member(std::uint64_t k) {
    k = (k + 1) * 0x9e3779b97f4a7c15u;
    k = (k ^ (k >> 30)) * 0xbf58476d1ce4e5b9u;
    k = (k ^ (k >> 27)) * 0x94d049bb133111ebu;
    return k ^ (k >> 31);
}

}  // namespace

void Mesh::build(const Robot& robot, const Configuration& q, const Accuracy& accuracy) {
    find_breaks(robot, q);
    place_nodes(robot, q, accuracy);
    fill_elements(robot, q);
    place_contacts();
    fill_pairs(robot);
    fill_regimes(robot);
    fill_laws(robot);
    publish();
}

bool Mesh::laid_out_like(const Mesh& other) const {
    return element_tubes_ == other.element_tubes_ && element_contacts_ == other.element_contacts_ && node_unknowns_ == other.node_unknowns_ &&
           std::equal(breaks_.begin(), breaks_.end(), other.breaks_.begin(), other.breaks_.end(),
                      [](const Break& a, const Break& b) { return a.members == b.members; });
}

bool Mesh::move_elements(const Mesh& from, const Robot& robot, const Configuration& q) {
    find_breaks(robot, q);
    if (!std::equal(breaks_.begin(), breaks_.end(), from.breaks_.begin(), from.breaks_.end(),
                    [](const Break& a, const Break& b) { return a.members == b.members; }))
        return false;
    element_tubes_ = from.element_tubes_;
    element_contacts_ = from.element_contacts_;
    s_.resize(from.s_.size());
    const std::vector<double>& breaks = from.break_s_;
    std::size_t b = 0;
    for (std::size_t k = 0; k < s_.size(); ++k) {
        const double s = from.s_[k];
        while (b + 2 < breaks.size() && s > breaks[b + 1] - 0.5 * kMergeDistance) ++b;  // a node on a break stays exactly there
        s_[k] = break_s_[b] + (s - breaks[b]) / (breaks[b + 1] - breaks[b]) * (break_s_[b + 1] - break_s_[b]);
    }
    fill_elements(robot, q);
    fill_pairs(robot);
    fill_regimes(robot);
    fill_laws(robot);
    publish();
    return node_unknowns_ == from.node_unknowns_;
}

bool Mesh::move(const Mesh& from, const Robot& robot, const Configuration& q) {
    if (!move_elements(from, robot, q)) return false;
    contact_begin_ = from.contact_begin_;
    contact_pair_ = from.contact_pair_;
    contact_xi_ = from.contact_xi_;
    for (auto [mine, theirs] : {std::pair{&contact_weight_, &from.contact_weight_}, {&contact_s_, &from.contact_s_}, {&contact_shape_, &from.contact_shape_}})
        mine->resize(theirs->size());
    for (std::size_t e = 0; e < length_.size(); ++e)
        for (int k = contact_begin_[e]; k < contact_begin_[e + 1]; ++k) {
            contact_weight_[k] = from.contact_weight_[k] * (length_[e] / from.length_[e]);
            contact_s_[k] = s_[e] + contact_xi_[k] * length_[e];
            hermite(contact_xi_[k], length_[e], &contact_shape_[4 * k]);
        }
    publish();
    return true;
}

void Mesh::find_breaks(const Robot& robot, const Configuration& q) {
    breaks_.clear();
    const int n = robot.count();
    for (int i = 0; i < n; ++i) {
        double s = q.l[i];
        breaks_.push_back({s, member(breaks_.size())});
        for (const Section& section : robot.tubes[i].sections) breaks_.push_back({s += section.length, member(breaks_.size())});
    }
    breaks_.push_back({0.0, member(breaks_.size())});
    for (Break& b : breaks_)
        if (std::fabs(b.s) <= kMergeDistance) b.s = 0;  // the plate draws from both sides, before others are merged
    const double first = q.l[n - 1], last = q.l[n - 1] + robot.tubes[n - 1].length();
    std::sort(breaks_.begin(), breaks_.end(), [](const Break& a, const Break& b) { return a.s < b.s; });
    std::vector<Break>& merged = found_;
    merged.clear();
    for (const Break& b : breaks_) {
        if (merged.empty() || b.s - merged.back().s > kMergeDistance) merged.push_back(b);
        else merged.back().members += b.members;
    }
    // the two ends are exact whatever was merged into them
    std::uint64_t members = 0;
    while (merged.size() > 1 && merged.back().s > last - kMergeDistance) {
        members += merged.back().members;
        merged.pop_back();
    }
    merged.front().s = first;
    merged.push_back({last, members});
    for (Break& b : merged)
        if (std::fabs(b.s) <= kMergeDistance) b.s = 0;
    breaks_.swap(merged);
    break_s_.clear();
    for (const Break& b : breaks_) break_s_.push_back(b.s);
}

void Mesh::place_nodes(const Robot& robot, const Configuration& q, const Accuracy& accuracy) {
    const int n = robot.count();
    s_.assign(1, breaks_.front().s);
    element_tubes_.clear();
    element_contacts_.clear();
    for (std::size_t b = 0; b + 1 < breaks_.size(); ++b) {
        const double from = breaks_[b].s, to = breaks_[b + 1].s, middle = 0.5 * (from + to), span = to - from;
        int present = 0;
        for (int i = 0; i < n; ++i)
            if (q.l[i] < middle && middle < q.l[i] + robot.tubes[i].length()) ++present;
        present = std::max(present, 1);
        // count = integral of ds / h(s), h growing linearly from both ends of the interval
        auto cumulative = [&](double x) {
            const double reach = (accuracy.coarsest - accuracy.finest) / accuracy.growth;
            const double near = std::log1p(accuracy.growth * std::min(x, reach) / accuracy.finest) / accuracy.growth;
            return near + std::max(0.0, x - reach) / accuracy.coarsest;
        };
        auto inverse = [&](double wanted) {
            const double reach = (accuracy.coarsest - accuracy.finest) / accuracy.growth, near = cumulative(reach);
            const double x = std::expm1(accuracy.growth * std::min(wanted, near)) * accuracy.finest / accuracy.growth;
            return x + std::max(0.0, wanted - near) * accuracy.coarsest;
        };
        // Spacings are asked for at a span of so many elements, so that contact points keep their number while it changes.
        auto nominal = [&](double k, int count) {
            const double distance = inverse(std::min(k, count - k) * (count - 0.5) / count);
            return 2 * k <= count ? distance : 2 * inverse(0.5 * count - 0.25) - distance;
        };
        const double half = cumulative(0.5 * span);
        const Section& inner = section_at(robot.tubes[n - 1], middle - q.l[n - 1]);
        const bool straight = inner.curvature_x == 0 && inner.curvature_y == 0 && !robot.loaded();
        const double longest = (straight ? kStraightLength : kSingleTubeLength) / accuracy.refinement;
        int count = present == 1 ? static_cast<int>(std::ceil(span / longest - 1e-9))
                                 : static_cast<int>(std::ceil(2 * half - 1e-9));
        count = std::max(count, 1);
        for (int k = 1; k <= count; ++k) {
            double x = span * k / count;
            if (present > 1 && k < count) {  // invert the cumulative count on the nearer half
                const double distance = inverse(2 * half * std::min(k, count - k) / count);
                x = 2 * k <= count ? distance : span - distance;
            }
            s_.push_back(k == count ? to : from + x);
            element_tubes_.push_back(present);
            const double h = nominal(k, count) - nominal(k - 1, count), middle_distance = std::min(nominal(k - 0.5, count), nominal(count - k + 0.5, count));
            const double spacing = std::min(accuracy.contact_coarsest, accuracy.contact_finest + accuracy.growth * middle_distance *
                                                                           accuracy.contact_coarsest / accuracy.coarsest);
            element_contacts_.push_back(present > 1 ? std::max(1, static_cast<int>(std::ceil(h / spacing - 1e-9))) : 0);
        }
    }
}

void Mesh::fill_elements(const Robot& robot, const Configuration& q) {
    const int n = robot.count(), elements = static_cast<int>(s_.size()) - 1;
    length_.resize(elements);
    element_regime_.resize(elements);
    element_unknowns_.resize(elements);
    precurvature_.assign(static_cast<std::size_t>(elements) * n * 4, 0.0);
    node_unknowns_.assign(elements + 1, 0);
    shaft_stiffness_.assign(n, 0.0);
    shaft_angle_.assign(n, 0.0);
    shaft_node_.assign(n, -1);
    for (int e = 0; e < elements; ++e) {
        length_[e] = s_[e + 1] - s_[e];
        const double middle = 0.5 * (s_[e] + s_[e + 1]);
        element_regime_[e] = (element_tubes_[e] - 1) * 2 + (middle < 0 ? 1 : 0);
        element_unknowns_[e] = 5 * element_tubes_[e] - (middle < q.l[0] ? 0 : 4);
        node_unknowns_[e + 1] = element_unknowns_[e];  // a tube that begins at a node is clamped there
        for (int t = 0; t < element_tubes_[e]; ++t) {
            const double base = q.l[n - 1 - t];
            for (int g = 0; g < 2; ++g)
                precurvature_at(robot.tubes[n - 1 - t], s_[e] + kGauss[g] * length_[e] - base, middle - base,
                                &precurvature_[((e * 2 + g) * n + t) * 2]);
            if (shaft_node_[t] >= 0) continue;
            shaft_node_[t] = e;
            shaft_angle_[t] = q.theta[n - 1 - t];
            const double compliance = robot.tubes[n - 1 - t].shaft_compliance;
            if (compliance < kRigidShaft) continue;
            shaft_stiffness_[t] = 1 / compliance;
            node_unknowns_[e] = 5 * t + 1;  // its angle there is free too
        }
    }
}

void Mesh::place_contacts() {
    const int elements = static_cast<int>(length_.size());
    contact_begin_.assign(1, 0);
    contact_pair_.clear();
    contact_shape_.clear();
    contact_xi_.clear();
    contact_weight_.clear();
    contact_s_.clear();
    for (int e = 0; e < elements; ++e) {
        const double h = length_[e];
        const int count = element_contacts_[e];
        const int before = e == 0 ? 1 : element_tubes_[e - 1];
        for (int p = 0; p < element_tubes_[e] - 1; ++p)  // pair by pair, as the kernels take them
            for (int k = p < before - 1 ? 1 : 0; k <= count; ++k) {  // 0 only where an overlap begins: the rim of the outer base
                const double xi = static_cast<double>(k) / count;
                contact_pair_.push_back(p);
                contact_xi_.push_back(xi);
                contact_weight_.push_back(h / count);
                contact_s_.push_back(s_[e] + xi * h);
                contact_shape_.resize(contact_shape_.size() + 4);
                hermite(xi, h, &contact_shape_[contact_shape_.size() - 4]);
            }
        contact_begin_.push_back(static_cast<int>(contact_pair_.size()));
    }
    for (std::vector<double>* values : {&contact_xi_, &contact_weight_}) values->resize(contact_pair_.size() + kLanes - 1);
    contact_shape_.resize(4 * contact_xi_.size());
}

void Mesh::fill_pairs(const Robot& robot) {
    const int n = robot.count();
    half_square_.resize(n);
    outer_arm_.resize(n);
    inner_arm_.resize(n);
    scale_.resize(n);
    for (int p = 0; p < n - 1; ++p) {
        const Pair& pair = robot.pairs[n - 2 - p];
        half_square_[p] = 0.5 * pair.clearance * pair.clearance;
        outer_arm_[p] = pair.outer_inner_radius / pair.clearance;
        inner_arm_[p] = pair.inner_outer_radius / pair.clearance;
        scale_[p] = pair.clearance;
    }
}

void Mesh::fill_laws(const Robot& robot) {
    const int n = robot.count();
    tubes_ = n;
    has_laws_ = !robot.linear_round() || robot.loaded();
    laws_.resize(n);
    for (int t = 0; t < n; ++t) {
        const Tube& tube = robot.tubes[n - 1 - t];
        const double knee = std::min(tube.softening_strain / tube.outer_radius, 1e50);
        laws_[t] = {tube.bending_stiffness, tube.ovality, tube.ovality_axis, knee, tube.softening_fraction};
    }
}

void Mesh::soften(const Robot& robot, double share) {
    for (int t = 0; t < tubes_; ++t) laws_[t].fraction = 1 - share * (1 - robot.tubes[tubes_ - 1 - t].softening_fraction);
}

// P = diag(EI) - EI EI^T / sum(EI) where the mean bending is free, diag(EI) behind the plate; C and D are its sums over
// the tubes inside a pair (docs/model.md).
void Mesh::fill_regimes(const Robot& robot) {
    const int n = robot.count();
    const std::size_t size = static_cast<std::size_t>(2 * n) * n * n;
    stiffness_.assign(size, 0.0);
    pair_stiffness_.assign(size, 0.0);
    mixed_stiffness_.assign(size, 0.0);
    for (int m = 1; m <= n; ++m)
        for (int guided = 0; guided < 2; ++guided) {
            const std::size_t base = static_cast<std::size_t>((m - 1) * 2 + guided) * n * n;
            double total = 0;
            for (int t = 0; t < m; ++t) total += robot.tubes[n - 1 - t].bending_stiffness;
            for (int t = 0; t < m; ++t)
                for (int l = 0; l < m; ++l) {
                    const double a = robot.tubes[n - 1 - t].bending_stiffness, b = robot.tubes[n - 1 - l].bending_stiffness;
                    stiffness_[base + t * n + l] = (t == l ? a : 0.0) - (guided ? 0.0 : a * b / total);
                }
            for (int p = 0; p < m; ++p)
                for (int t = 0; t < m; ++t) {
                    double sum = 0;
                    for (int l = 0; l <= p; ++l) sum += stiffness_[base + l * n + t];
                    mixed_stiffness_[base + p * n + t] = sum;
                }
            for (int p = 0; p < m; ++p)
                for (int r = 0; r < m; ++r) {
                    double sum = 0;
                    for (int l = 0; l <= r; ++l) sum += mixed_stiffness_[base + p * n + l];
                    pair_stiffness_[base + p * n + r] = sum;
                }
        }
    torsional_.resize(n);
    bending_.resize(n);
    outer_radius_.resize(n);
    for (int t = 0; t < n; ++t) {
        const Tube& tube = robot.tubes[n - 1 - t];
        torsional_[t] = tube.torsional_stiffness;
        bending_[t] = tube.bending_stiffness;
        outer_radius_[t] = tube.outer_radius;
    }
}

void Mesh::publish() {
    problem_.tubes = tubes_;
    problem_.nodes = static_cast<int>(s_.size());
    problem_.elements = static_cast<int>(length_.size());
    problem_.contacts = static_cast<int>(contact_pair_.size());
    problem_.stride = 5 * problem_.tubes - 4;
    problem_.node_unknowns = node_unknowns_.data();
    problem_.element_tubes = element_tubes_.data();
    problem_.element_unknowns = element_unknowns_.data();
    problem_.element_regime = element_regime_.data();
    problem_.length = length_.data();
    problem_.precurvature = precurvature_.data();
    problem_.stiffness = stiffness_.data();
    problem_.pair_stiffness = pair_stiffness_.data();
    problem_.mixed_stiffness = mixed_stiffness_.data();
    problem_.torsional_stiffness = torsional_.data();
    problem_.bending_stiffness = bending_.data();
    problem_.outer_radius = outer_radius_.data();
    problem_.law = has_laws_ ? laws_.data() : nullptr;
    problem_.shaft_stiffness = shaft_stiffness_.data();
    problem_.shaft_angle = shaft_angle_.data();
    problem_.shaft_node = shaft_node_.data();
    problem_.contact_begin = contact_begin_.data();
    problem_.contact_pair = contact_pair_.data();
    problem_.contact_shape = contact_shape_.data();
    problem_.contact_xi = contact_xi_.data();
    problem_.contact_weight = contact_weight_.data();
    problem_.half_square_clearance = half_square_.data();
    problem_.outer_torque_arm = outer_arm_.data();
    problem_.inner_torque_arm = inner_arm_.data();
    problem_.barrier_scale = scale_.data();
}

}  // namespace ctr
