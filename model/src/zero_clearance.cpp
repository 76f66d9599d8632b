#include "ctr/zero_clearance.hpp"

#include <algorithm>
#include <cmath>

#include "ctr/kernel.hpp"

namespace ctr {
namespace {

constexpr double kElementLength = 12e-3;  // m; leaves less than 1e-6 m at the tip of the three-tube robot
constexpr double kMergeDistance = 1e-7;   // m
constexpr double kTolerance = 1e-11;      // torque imbalance over EI * precurvature
constexpr double kAligned = 1.0;          // rad; pairs turned less than this against each other have one well
constexpr double kDistinct = 0.1;         // rad between the angles of different equilibria
constexpr int kMaxNewton = 12;
constexpr double kFirstCorrection = 0.35; // rad: a larger first corrector step means the predictor left the branch

constexpr double kPoint[3] = {0.11270166537925831148, 0.5, 0.88729833462074168852};
constexpr double kWeight[3] = {5.0 / 18, 8.0 / 18, 5.0 / 18};

}  // namespace

void ZeroClearance::build(const Robot& robot, const Configuration& q) {
    n_ = robot.count();
    ld_ = 2 * n_;
    gj_.resize(n_);
    base_theta_.resize(n_);
    base_l_.resize(n_);
    shaft_.resize(n_);
    end_s_.resize(n_);
    std::vector<double> breaks{0.0};
    scale_moment_ = 1e-12;
    for (int t = 0; t < n_; ++t) {
        const int i = n_ - 1 - t;
        const Tube& tube = robot.tubes[i];
        gj_[t] = tube.torsional_stiffness;
        base_theta_[t] = q.theta[i];
        base_l_[t] = q.l[i];
        shaft_[t] = tube.shaft_compliance;
        double s = q.l[i];
        for (const Section& section : tube.sections) {
            s += section.length;
            if (s > 0) breaks.push_back(s);
            scale_moment_ = std::max(scale_moment_, tube.bending_stiffness * std::hypot(section.curvature_x, section.curvature_y));
        }
        end_s_[t] = s;
    }
    // beyond the second longest tube nothing twists
    const double end = n_ > 1 ? end_s_[1] : 0.0;
    std::sort(breaks.begin(), breaks.end());
    s_.assign(1, 0.0);
    for (double b : breaks) {
        if (b > end + kMergeDistance) break;
        const double from = s_.back(), span = b - from;
        if (span <= kMergeDistance) continue;
        const int count = std::max(1, static_cast<int>(std::ceil(span / kElementLength - 1e-9)));
        for (int k = 1; k <= count; ++k) s_.push_back(from + span * k / count);
    }
    nodes_ = static_cast<int>(s_.size());
    tubes_.assign(nodes_, n_);
    v_.assign(static_cast<std::size_t>(nodes_) * 3 * n_ * 2, 0.0);
    P_.assign(static_cast<std::size_t>(n_ + 1) * n_ * n_, 0.0);
    for (int m = 1; m <= n_; ++m) {
        double total = 0;
        for (int t = 0; t < m; ++t) total += robot.tubes[n_ - 1 - t].bending_stiffness;
        for (int t = 0; t < m; ++t)
            for (int l = 0; l < m; ++l) {
                const double a = robot.tubes[n_ - 1 - t].bending_stiffness, b = robot.tubes[n_ - 1 - l].bending_stiffness;
                P_[(m * n_ + t) * n_ + l] = (t == l ? a : 0.0) - a * b / total;
            }
    }
    for (int e = 0; e + 1 < nodes_; ++e) {
        const double middle = 0.5 * (s_[e] + s_[e + 1]);
        int m = 0;
        for (int t = 0; t < n_; ++t)
            if (middle < end_s_[t]) ++m;
        tubes_[e] = m;
        for (int g = 0; g < 3; ++g)
            for (int t = 0; t < m; ++t)
                precurvature_at(robot.tubes[n_ - 1 - t], s_[e] + kPoint[g] * (s_[e + 1] - s_[e]) - base_l_[t], middle - base_l_[t],
                                &v_[((e * 3 + g) * n_ + t) * 2]);
    }
    const std::size_t block = static_cast<std::size_t>(nodes_) * ld_ * ld_, vector = static_cast<std::size_t>(nodes_) * ld_;
    x_.assign(vector, 0.0);
    r_.resize(vector);
    step_.resize(vector);
    tangent_.resize(vector);
    A_.resize(block);
    U_.resize(block);
    L_.resize(block);
    for (int k = 0; k < nodes_; ++k)
        for (int t = 0; t < n_; ++t) x_[k * ld_ + 2 * t] = base_theta_[t];
}

bool ZeroClearance::is_clamped(int t) const { return -base_l_[t] <= kMergeDistance && shaft_[t] == 0; }

double ZeroClearance::transmission_stiffness(int t) const { return 1 / (shaft_[t] - base_l_[t] / gj_[t]); }

// Unknowns of a node: [theta_t, theta_t'] innermost first. Returns the largest torque imbalance at the present angles.
double ZeroClearance::assemble(double scale, bool factor) {
    std::fill(r_.begin(), r_.end(), 0.0);
    if (factor) {
        std::fill(A_.begin(), A_.end(), 0.0);
        std::fill(U_.begin(), U_.end(), 0.0);
    }
    energy_ = 0;
    const int block = ld_ * ld_;
    // transmission behind the plate: a torsion spring from the collar, or a fixed angle where the collar is at the plate
    for (int t = 0; t < n_; ++t) {
        if (is_clamped(t)) continue;
        const double k = transmission_stiffness(t), turn = x_[2 * t] - base_theta_[t];
        energy_ += 0.5 * k * turn * turn;
        r_[2 * t] += k * turn;
        if (factor) A_[2 * t * ld_ + 2 * t] += k;
    }
    for (int e = 0; e + 1 < nodes_; ++e) {
        const int m = tubes_[e];
        const double h = s_[e + 1] - s_[e];
        const double *xa = &x_[e * ld_], *xb = &x_[(e + 1) * ld_], *P = &P_[m * n_ * n_];
        double *ra = &r_[e * ld_], *rb = &r_[(e + 1) * ld_];
        double* blocks[2][2] = {{&A_[e * block], &U_[e * block]}, {nullptr, &A_[(e + 1) * block]}};
        for (int gauss = 0; gauss < 3; ++gauss) {
            const double x = kPoint[gauss], weight = kWeight[gauss] * h, *v = &v_[(e * 3 + gauss) * n_ * 2];
            const double N[4] = {1 - 3 * x * x + 2 * x * x * x, h * (x - 2 * x * x + x * x * x), 3 * x * x - 2 * x * x * x,
                                 h * (x * x * x - x * x)};
            const double B[4] = {6 * (x * x - x) / h, 1 - 4 * x + 3 * x * x, 6 * (x - x * x) / h, 3 * x * x - 2 * x};
            double w[kMaxTubes][2], g[kMaxTubes][2], rate[kMaxTubes];
            for (int t = 0; t < m; ++t) {
                const double theta = N[0] * xa[2 * t] + N[1] * xa[2 * t + 1] + N[2] * xb[2 * t] + N[3] * xb[2 * t + 1];
                rate[t] = B[0] * xa[2 * t] + B[1] * xa[2 * t + 1] + B[2] * xb[2 * t] + B[3] * xb[2 * t + 1];
                const double c = std::cos(theta), s = std::sin(theta), vx = v[2 * t], vy = v[2 * t + 1];
                w[t][0] = c * vx - s * vy;
                w[t][1] = s * vx + c * vy;
            }
            for (int t = 0; t < m; ++t) {
                g[t][0] = g[t][1] = 0;
                for (int l = 0; l < m; ++l) {
                    g[t][0] += P[t * n_ + l] * w[l][0];
                    g[t][1] += P[t * n_ + l] * w[l][1];
                }
                energy_ += weight * (0.5 * gj_[t] * rate[t] * rate[t] + 0.5 * scale * (g[t][0] * w[t][0] + g[t][1] * w[t][1]));
                // dE/dtheta_t = g . J w
                const double torque = weight * scale * (g[t][1] * w[t][0] - g[t][0] * w[t][1]);
                const double twist = weight * gj_[t] * rate[t];
                for (int a = 0; a < 2; ++a) {
                    ra[2 * t + a] += N[a] * torque + B[a] * twist;
                    rb[2 * t + a] += N[2 + a] * torque + B[2 + a] * twist;
                }
            }
            if (!factor) continue;
            for (int t = 0; t < m; ++t)
                for (int l = 0; l < m; ++l) {
                    double value = scale * weight * P[t * n_ + l] * (w[t][0] * w[l][0] + w[t][1] * w[l][1]);
                    double twist = 0;
                    if (t == l) {
                        value -= scale * weight * (g[t][0] * w[t][0] + g[t][1] * w[t][1]);
                        twist = weight * gj_[t];
                    }
                    for (int a = 0; a < 4; ++a)
                        for (int b = (a & 2); b < 4; ++b)  // lower triangle of nodes is the transpose
                            blocks[a >> 1][b >> 1][(2 * t + (a & 1)) * ld_ + 2 * l + (b & 1)] +=
                                value * N[a] * N[b] + twist * B[a] * B[b];
                }
        }
    }
    // fixed and absent unknowns: identity rows
    double worst = 0;
    for (int k = 0; k < nodes_; ++k) {
        const int m = k == 0 ? n_ : tubes_[k - 1];
        for (int i = 0; i < ld_; ++i) {
            const bool absent = i >= 2 * m || nodes_ == 1;
            const bool fixed = k == 0 && i % 2 == 0 && is_clamped(i / 2);
            if (absent || fixed) {
                r_[k * ld_ + i] = 0;
                if (factor) {
                    for (int j = 0; j < ld_; ++j) {
                        A_[k * block + i * ld_ + j] = A_[k * block + j * ld_ + i] = i == j ? 1.0 : 0.0;
                        U_[k * block + i * ld_ + j] = 0;
                        if (k > 0) U_[(k - 1) * block + j * ld_ + i] = 0;
                    }
                }
            } else {
                const double unit = i % 2 ? 1 / kElementLength : 1.0;
                worst = std::max(worst, std::fabs(r_[k * ld_ + i]) * unit);
            }
        }
    }
    return worst / scale_moment_;
}

// Symmetric block elimination without pivoting; counts negative pivots (the inertia of the second variation).
void ZeroClearance::solve_system() {
    const int block = ld_ * ld_;
    negative_ = 0;
    for (int k = 0; k < nodes_; ++k) {
        double *A = &A_[k * block], *U = &U_[k * block], *r = &r_[k * ld_];
        const bool last = k + 1 == nodes_;
        const int width = last ? 0 : ld_;
        if (!last) std::copy(U, U + block, &L_[k * block]);
        for (int j = 0; j < ld_; ++j) {
            if (A[j * ld_ + j] < 0) ++negative_;
            const double pivot = 1 / A[j * ld_ + j];
            for (int i = j + 1; i < ld_; ++i) {
                const double f = A[i * ld_ + j] * pivot;
                if (f == 0) continue;
                for (int c = j; c < ld_; ++c) A[i * ld_ + c] -= f * A[j * ld_ + c];
                for (int c = 0; c < width; ++c) U[i * ld_ + c] -= f * U[j * ld_ + c];
                r[i] -= f * r[j];
            }
        }
        for (int i = ld_ - 1; i >= 0; --i) {
            const double pivot = 1 / A[i * ld_ + i];
            for (int j = i + 1; j < ld_; ++j) {
                const double f = A[i * ld_ + j];
                if (f == 0) continue;
                for (int c = 0; c < width; ++c) U[i * ld_ + c] -= f * U[j * ld_ + c];
                r[i] -= f * r[j];
            }
            for (int c = 0; c < width; ++c) U[i * ld_ + c] *= pivot;
            r[i] *= pivot;
        }
        if (last) break;
        const double* T = &L_[k * block];  // the coupling block before elimination; its transpose is the lower one
        double *next = &A_[(k + 1) * block], *next_r = &r_[(k + 1) * ld_];
        for (int j = 0; j < ld_; ++j)
            for (int i = 0; i < ld_; ++i) {
                const double f = T[j * ld_ + i];
                if (f == 0) continue;
                for (int c = 0; c < ld_; ++c) next[i * ld_ + c] -= f * U[j * ld_ + c];
                next_r[i] -= f * r[j];
            }
    }
    for (int k = nodes_ - 1; k >= 0; --k)
        for (int i = 0; i < ld_; ++i) {
            double sum = -r_[k * ld_ + i];
            if (k + 1 < nodes_)
                for (int j = 0; j < ld_; ++j) sum -= U_[k * block + i * ld_ + j] * step_[(k + 1) * ld_ + j];
            step_[k * ld_ + i] = sum;
        }
}

bool ZeroClearance::correct(double scale, double first_step_limit) {
    double previous = 1e300;
    for (int k = 0; k < kMaxNewton; ++k) {
        residual_ = assemble(scale, true);
        if (!std::isfinite(residual_)) return false;
        const double imbalance = residual_;
        solve_system();
        ++iterations_;
        double largest = 0;
        for (int node = 0; node < nodes_; ++node)
            for (int t = 0; t < n_; ++t) largest = std::max(largest, std::fabs(step_[node * ld_ + 2 * t]));
        if (!std::isfinite(largest)) return false;
        if (k == 0 && largest > first_step_limit) return false;
        if (imbalance < kTolerance) return true;
        if (k > 2 && largest > 0.9 * previous && imbalance > 1e3 * kTolerance) return false;  // not contracting: leave it
        previous = largest;
        for (std::size_t i = 0; i < x_.size(); ++i) x_[i] += step_[i];
    }
    return assemble(scale, false) < kTolerance;
}

bool ZeroClearance::solve(const Robot& robot, const Configuration& q) {
    build(robot, q);
    iterations_ = 0;
    double scale = 0, step = 0.5;
    std::fill(tangent_.begin(), tangent_.end(), 0.0);
    double tangent_step = 1;
    while (scale < 1) {
        const double next = std::min(1.0, scale + step);
        best_ = x_;
        for (std::size_t i = 0; i < x_.size(); ++i) x_[i] += tangent_[i] * (next - scale) / tangent_step;
        if (correct(next, kFirstCorrection)) {
            for (std::size_t i = 0; i < x_.size(); ++i) tangent_[i] = x_[i] - best_[i];
            tangent_step = next - scale;
            scale = next;
            step = std::min(1.5 * step, 0.5);
        } else {
            x_ = best_;
            step *= 0.5;
            if (step < 1e-5) return false;
        }
    }
    residual_ = assemble(1.0, false);
    return residual_ < 10 * kTolerance;
}

bool ZeroClearance::restart(const Robot& robot, const Configuration& q, const std::vector<double>& twist) {
    const std::vector<double> kept = x_;
    build(robot, q);
    if (kept.size() == x_.size()) x_ = kept;
    for (int k = 0; k < nodes_; ++k)
        for (int t = 0; t < n_; ++t) x_[k * ld_ + 2 * t] += twist[t] * (s_[k] - base_l_[t]) / std::max(s_.back() - base_l_[t], 1e-9);
    iterations_ = 0;
    const bool done = correct(1.0, 1e9);
    residual_ = assemble(1.0, false);
    return done;
}

int ZeroClearance::search_other(const Robot& robot, const Configuration& q, int from, ZeroClearance& other) const {
    constexpr double kTurns[] = {1.25, 1.0, 1.5, 3.0};
    constexpr int kCount = 4;
    std::vector<double> twist(n_);
    for (int attempt = from; attempt < kCount * (n_ - 1); ++attempt) {
        const int inner = attempt / kCount;  // pairs counted from the innermost
        const double tip = end_s_[inner + 1];
        const double between = std::remainder(theta(inner, tip) - theta(inner + 1, tip), 2 * 3.141592653589793);
        if (std::fabs(between) < kAligned) continue;
        for (int t = 0; t < n_; ++t) twist[t] = t <= inner ? std::copysign(kTurns[attempt % kCount], between) : 0.0;
        other = *this;
        if (!other.restart(robot, q, twist) || other.negative_pivots() > 0) continue;
        for (int t = 0; t < n_; ++t)
            if (std::fabs(other.theta(t, end_s_[t]) - theta(t, end_s_[t])) > kDistinct) return attempt;
    }
    return -1;
}

int ZeroClearance::locate(double s) const {
    const auto it = std::upper_bound(s_.begin(), s_.end(), s);
    return std::clamp(static_cast<int>(it - s_.begin()) - 1, 0, nodes_ - 2);
}

double ZeroClearance::theta(int t, double s) const {
    if (s <= 0) {
        if (is_clamped(t)) return base_theta_[t];
        const double torque = transmission_stiffness(t) * (x_[2 * t] - base_theta_[t]);
        return base_theta_[t] + torque * (shaft_[t] + std::clamp(s - base_l_[t], 0.0, -base_l_[t]) / gj_[t]);
    }
    if (nodes_ < 2) return x_[2 * t];
    const double last = std::min(s, std::min(end_s_[t], s_.back()));
    const int e = locate(std::nextafter(last, -1.0));
    const double h = s_[e + 1] - s_[e], x = std::clamp((last - s_[e]) / h, 0.0, 1.0);
    const double *a = &x_[e * ld_ + 2 * t], *b = &x_[(e + 1) * ld_ + 2 * t];
    return (1 - 3 * x * x + 2 * x * x * x) * a[0] + h * (x - 2 * x * x + x * x * x) * a[1] +
           (3 * x * x - 2 * x * x * x) * b[0] + h * (x * x * x - x * x) * b[1];
}

double ZeroClearance::twist_rate(int t, double s) const {
    if (s <= 0) {
        return is_clamped(t) ? 0.0 : transmission_stiffness(t) * (x_[2 * t] - base_theta_[t]) / gj_[t];
    }
    if (nodes_ < 2 || s >= std::min(end_s_[t], s_.back())) return 0.0;
    const int e = locate(s);
    const double h = s_[e + 1] - s_[e], x = (s - s_[e]) / h;
    const double *a = &x_[e * ld_ + 2 * t], *b = &x_[(e + 1) * ld_ + 2 * t];
    return 6 * (x * x - x) / h * a[0] + (1 - 4 * x + 3 * x * x) * a[1] + 6 * (x - x * x) / h * b[0] +
           (3 * x * x - 2 * x) * b[1];
}

}  // namespace ctr
