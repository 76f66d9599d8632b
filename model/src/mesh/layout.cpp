// Where the nodes and the possible contacts of a mesh are.
#include <algorithm>
#include <cmath>

#include "ctr/mesh.hpp"

namespace ctr {
namespace {

#include "mesh/element_functions.hpp"
#include "mesh/merge_distance.hpp"

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

// Elements whose length grows linearly with the distance from a break, up to the coarsest.
struct Grading {
    explicit Grading(const Accuracy& accuracy)
        : finest(accuracy.finest), coarsest(accuracy.coarsest), growth(accuracy.growth), reach((coarsest - finest) / growth) {}
    // As many as fit between the break and a distance: the integral of ds / h(s).
    double elements(double x) const { return std::log1p(growth * std::min(x, reach) / finest) / growth + std::max(0.0, x - reach) / coarsest; }
    // And the distance that so many reach.
    double distance(double count) const {
        const double near = elements(reach);
        return std::expm1(growth * std::min(count, near)) * finest / growth + std::max(0.0, count - near) * coarsest;
    }
    double finest, coarsest, growth, reach;
};

}  // namespace

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
    const double first = q.l[n - 1], last = tip_s(robot, q);
    std::sort(breaks_.begin(), breaks_.end(), [](const Break& a, const Break& b) { return a.s < b.s; });
    std::vector<Break>& merged = found_;
    merged.clear();
    double begin = 0;
    int count = 0;
    for (const Break& b : breaks_) {
        if (merged.empty() || b.s - begin > kMergeDistance) {
            merged.push_back(b);
            begin = b.s;
            count = 1;
        } else {  // in their middle, which moves smoothly with each of them
            merged.back().members += b.members;
            merged.back().s += (b.s - merged.back().s) / ++count;
        }
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

// How many elements stand between breaks, and how many contact points in each.
void Mesh::count_elements(const Robot& robot, const Configuration& q) {
    const int n = robot.count();
    const Grading grading{accuracy_};
    interval_elements_.clear();
    element_tubes_.clear();
    element_contacts_.clear();
    for (std::size_t b = 0; b + 1 < breaks_.size(); ++b) {
        const double from = breaks_[b].s, to = breaks_[b + 1].s, middle = 0.5 * (from + to), span = to - from;
        int outermost = 0;  // of those that are there; what has ended inside it goes on as a ghost
        while (outermost < n - 1 && !(q.l[outermost] < middle && middle < q.l[outermost] + robot.tubes[outermost].length())) ++outermost;
        const int present = n - outermost;
        // Spacings are asked for at a span of so many elements, so that contact points keep their number while it changes.
        auto nominal = [&](double k, int count) {
            const double distance = grading.distance(std::min(k, count - k) * (count - 0.5) / count);
            return 2 * k <= count ? distance : 2 * grading.distance(0.5 * count - 0.25) - distance;
        };
        const Section& inner = section_at(robot.tubes[n - 1], middle - q.l[n - 1]);
        const bool straight = inner.curvature_x == 0 && inner.curvature_y == 0 && !robot.loaded();
        const double longest = (straight ? kStraightLength : kSingleTubeLength) / accuracy_.refinement;
        const double wanted = present == 1 ? span / longest : 2 * grading.elements(0.5 * span);
        const int count = std::max(1, static_cast<int>(std::ceil(wanted - 1e-9)));
        interval_elements_.push_back(count);
        for (int k = 1; k <= count; ++k) {
            element_tubes_.push_back(present);
            const double h = nominal(k, count) - nominal(k - 1, count), middle_distance = std::min(nominal(k - 0.5, count), nominal(count - k + 0.5, count));
            const double spacing = std::min(accuracy_.contact_coarsest, accuracy_.contact_finest + accuracy_.growth * middle_distance *
                                                                            accuracy_.contact_coarsest / accuracy_.coarsest);
            element_contacts_.push_back(present > 1 ? std::max(1, static_cast<int>(std::ceil(h / spacing - 1e-9))) : 0);
        }
    }
}

// So many elements between breaks: evenly along a single tube, else graded from both ends.
void Mesh::place_nodes() {
    const Grading grading{accuracy_};
    s_.assign(1, breaks_.front().s);
    for (std::size_t b = 0; b + 1 < breaks_.size(); ++b) {
        const double from = breaks_[b].s, to = breaks_[b + 1].s, span = to - from, half = grading.elements(0.5 * span);
        const int count = interval_elements_[b];
        const bool graded = element_tubes_[s_.size() - 1] > 1;
        for (int k = 1; k < count; ++k) {
            double x = span * k / count;
            if (graded) {  // invert the cumulative count on the nearer half
                const double distance = grading.distance(2 * half * std::min(k, count - k) / count);
                x = 2 * k <= count ? distance : span - distance;
            }
            s_.push_back(from + x);
        }
        s_.push_back(to);
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

}  // namespace ctr
