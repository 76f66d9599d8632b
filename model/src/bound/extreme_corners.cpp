#include "bound/extreme_corners.hpp"

#include <algorithm>
#include <cmath>
#include <map>

namespace ctr {
namespace {

constexpr std::size_t kCandidates = 12;  // vertices that are solved, for the position and for the tangent
constexpr std::size_t kKept = 8;         // corners that are returned, likewise
constexpr int kRounds = 4;               // of turning pairs around

using Signs = std::vector<signed char>;

struct Deviation {
    bool reached = false;
    double of[2] = {0, 0};  // of the tip, m; of its tangent, as a chord
};

Vec3 minus(const Vec3& a, const Vec3& b) { return {a[0] - b[0], a[1] - b[1], a[2] - b[2]}; }

class Search {
  public:
    Search(BoundSolver& solver, const Configuration& q, const Accuracy& accuracy)
        : solver_(solver), start_(solver.begin_states(q, accuracy)), pairs_(q.l.size() - 1) {}

    Signs run() {
        measure_pairs();
        for (int kind = 0; kind < 2; ++kind) propose(kind);
        visit();
        for (int round = 0; round < kRounds; ++round) {
            for (int kind = 0; kind < 2; ++kind) propose_neighbours(best(kind, 1));
            if (!visit()) break;
        }
        return chosen();
    }

  private:
    void solve(const std::vector<double>& phi, const std::function<void(std::size_t, const Backbone&, bool)>& show) {
        solver_.solve_states(start_, {phi.data(), phi.size() / pairs_, 1}, [&](std::size_t row, const FrictionShape& found) {
            show(row, found.backbone, found.convergence.converged);
        });
    }

    // Half the way of tip and tangent from one sign of a pair to the other, all others without friction.
    void measure_pairs() {
        std::vector<double> phi((2 * pairs_ + 1) * pairs_, 0.0);
        for (std::size_t i = 0; i < pairs_; ++i) {
            phi[2 * i * pairs_ + i] = 1;
            phi[(2 * i + 1) * pairs_ + i] = -1;
        }
        std::vector<Vec3> at[2] = {std::vector<Vec3>(2 * pairs_ + 1), std::vector<Vec3>(2 * pairs_ + 1)};
        solve(phi, [&](std::size_t row, const Backbone& shape, bool) {
            at[0][row] = shape.tip.p;
            at[1][row] = shape.tip.tangent();
        });
        for (int kind = 0; kind < 2; ++kind) {
            free_[kind] = at[kind].back();
            for (std::size_t i = 0; i < pairs_; ++i) {
                const Vec3 way = minus(at[kind][2 * i], at[kind][2 * i + 1]);
                effect_[kind].push_back({0.5 * way[0], 0.5 * way[1], 0.5 * way[2]});
            }
        }
    }

    // Vertices of the sum of all effects that are farthest from its middle, from the normals of its facets and of its edges.
    void propose(int kind) {
        std::vector<std::pair<double, Signs>> found;
        auto add = [&](const Vec3& towards, std::size_t i, std::size_t j) {
            for (int turn = 0; turn < 8; ++turn) {
                Signs signs(pairs_);
                for (std::size_t k = 0; k < pairs_; ++k) signs[k] = ((dot(effect_[kind][k], towards) >= 0) != ((turn & 4) != 0)) ? 1 : -1;
                signs[i] = turn & 1 ? 1 : -1;
                signs[j] = turn & 2 ? 1 : -1;
                Vec3 sum{0, 0, 0};
                for (std::size_t k = 0; k < pairs_; ++k)
                    for (int x = 0; x < 3; ++x) sum[x] += signs[k] * effect_[kind][k][x];
                found.emplace_back(-dot(sum, sum), signs);
            }
        };
        for (std::size_t i = 0; i < pairs_; ++i)
            for (std::size_t j = i; j < pairs_; ++j) add(i == j ? effect_[kind][i] : cross(effect_[kind][i], effect_[kind][j]), i, j);
        std::sort(found.begin(), found.end());
        found.erase(std::unique(found.begin(), found.end()), found.end());
        for (std::size_t k = 0; k < std::min(kCandidates, found.size()); ++k) wanted_.push_back(found[k].second);
    }

    void propose_neighbours(const std::vector<Signs>& around) {
        for (const Signs& corner : around)
            for (std::size_t i = 0; i < pairs_; ++i) {
                wanted_.push_back(corner);
                wanted_.back()[i] *= -1;
            }
    }

    // Solves what is wanted and not known; false if that was nothing.
    bool visit() {
        std::sort(wanted_.begin(), wanted_.end());
        wanted_.erase(std::unique(wanted_.begin(), wanted_.end()), wanted_.end());
        std::erase_if(wanted_, [&](const Signs& signs) { return known_.count(signs) > 0; });
        std::vector<double> phi;
        for (const Signs& signs : wanted_) phi.insert(phi.end(), signs.begin(), signs.end());
        if (phi.empty()) return false;
        solve(phi, [&](std::size_t row, const Backbone& shape, bool converged) {
            Deviation& deviation = known_[wanted_[row]];
            deviation.reached = converged;
            const Vec3 apart[2] = {minus(shape.tip.p, free_[0]), minus(shape.tip.tangent(), free_[1])};
            for (int kind = 0; kind < 2; ++kind) deviation.of[kind] = std::sqrt(dot(apart[kind], apart[kind]));
        });
        wanted_.clear();
        return true;
    }

    // Those that lead farthest, first; those that were not reached before all others if asked for.
    std::vector<Signs> best(int kind, std::size_t count, bool unreached_first = false) const {
        std::vector<std::pair<double, Signs>> order;
        for (const auto& [signs, deviation] : known_)
            if (deviation.reached || unreached_first) order.emplace_back(deviation.reached ? -deviation.of[kind] : -1e300, signs);
        std::sort(order.begin(), order.end());
        std::vector<Signs> first;
        for (std::size_t k = 0; k < std::min(count, order.size()); ++k) first.push_back(order[k].second);
        return first;
    }

    Signs chosen() const {
        std::vector<Signs> all = best(0, kKept, true);
        for (const Signs& signs : best(1, kKept, true)) all.push_back(signs);
        std::sort(all.begin(), all.end(), std::greater<>());  // as itertools.product((1, -1)) has them
        all.erase(std::unique(all.begin(), all.end()), all.end());
        Signs flat;
        for (const Signs& signs : all) flat.insert(flat.end(), signs.begin(), signs.end());
        return flat;
    }

    BoundSolver& solver_;
    const FrictionlessStart start_;
    std::size_t pairs_;
    Vec3 free_[2];
    std::vector<Vec3> effect_[2];
    std::vector<Signs> wanted_;
    std::map<Signs, Deviation> known_;
};

}  // namespace

std::vector<signed char> extreme_corners(BoundSolver& solver, const Configuration& q, const Accuracy& accuracy) {
    if (q.l.size() < 2) return {};
    return Search(solver, q, accuracy).run();
}

}  // namespace ctr
