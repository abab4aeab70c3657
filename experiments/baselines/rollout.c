/* The paper preset's fitness in plain C: what the machine can do.

Same model and same arithmetic as the library's kinematic world: layout paper-31 with
output "scale", a unicycle on exact arcs with its heading as a unit vector, a ball and one
obstacle that stand still, 220 control steps, the paper's F.  Trials lie side by side in blocks
that stay in the L1 cache; the loop over a block is vectorised by the compiler, expf by libmvec:

    cc -O3 -march=native -ffast-math -fopenmp-simd -shared -fPIC rollout.c -lm
*/

#include <math.h>

enum { GENES = 31, STEPS = 220, BLOCK = 64, SCENE = 8 };

static inline float sigmoid_share(float x, float a1, float c1, float a2, float c2) {
    float e1 = expf(fminf(fmaxf(a1 * (c1 - x), -60.0f), 60.0f));
    float e2 = expf(fminf(fmaxf(a2 * (c2 - x), -60.0f), 60.0f));
    return (1.0f + e2) / (2.0f + e1 + e2);
}

/* atan2(y, x): the library's polynomial. */
static inline float bearing(float x, float y) {
    float ax = fabsf(x), ay = fabsf(y);
    float t = fminf(ax, ay) / fmaxf(fmaxf(ax, ay), 1e-30f), s = t * t;
    float p = -0.0040545651f;
    p = p * s + 0.02186295f;
    p = p * s - 0.0559123151f;
    p = p * s + 0.0964219645f;
    p = p * s - 0.139086292f;
    p = p * s + 0.199465656f;
    p = p * s - 0.333298608f;
    p = p * s + 0.999999336f;
    float angle = p * t;
    angle = ay > ax ? 1.57079632679f - angle : angle;
    angle = x < 0.0f ? 3.14159265359f - angle : angle;
    return y < 0.0f ? -angle : angle;
}

/* One block of trials: what changes, what stays, and what the fitness asks for. */
struct block {
    float x[BLOCK], y[BLOCK], cos[BLOCK], sin[BLOCK];
    float ball_x[BLOCK], ball_y[BLOCK], disc_x[BLOCK], disc_y[BLOCK], disc_r[BLOCK];
    float gene[GENES][BLOCK];
    float distance[BLOCK], v[BLOCK], omega[BLOCK]; /* after the newest step */
    float clearance[BLOCK], v_peak[BLOCK];
};

/* Distance to the nearest surface, and a vector towards it. */
static inline float nearest(float x, float y, float dx, float dy, float radius, float *ux,
                            float *uy) {
    float to_x = 1.4f - fabsf(x), to_y = 0.9f - fabsf(y);
    float d = fminf(to_x, to_y), to_disc = sqrtf(dx * dx + dy * dy) - radius;
    int disc = to_disc < d, wall_x = to_x < to_y;
    *ux = disc ? dx : wall_x ? (x < 0.0f ? -1.0f : 1.0f) : 0.0f;
    *uy = disc ? dy : wall_x ? 0.0f : (y < 0.0f ? -1.0f : 1.0f);
    return disc ? to_disc : d;
}

static void step(struct block *b, float dt) {
#pragma omp simd
    for (int n = 0; n < BLOCK; n++) {
        const float x = b->x[n], y = b->y[n], c = b->cos[n], s = b->sin[n];
#define G(k) b->gene[k][n]
        /* observe */
        float bx = b->ball_x[n] - x, by = b->ball_y[n] - y, ux, uy;
        float d_ball = sqrtf(bx * bx + by * by);
        float d_obst = nearest(x, y, b->disc_x[n] - x, b->disc_y[n] - y, b->disc_r[n], &ux, &uy);
        float theta_ball = bearing(c * bx + s * by, c * by - s * bx);
        float theta_obst = bearing(c * ux + s * uy, c * uy - s * ux);
        b->clearance[n] = fminf(b->clearance[n], d_obst);
        /* the FNTG: memberships, then the weighted averages, family by family */
        float A = sigmoid_share(d_ball, G(0), G(1), G(2), G(3));
        float B = sigmoid_share(d_obst, G(4), G(5), G(6), G(7));
        float C = sigmoid_share(theta_ball, G(8), G(9), G(10), G(11));
        float D = expf(-theta_obst * theta_obst * (0.5f / fmaxf(G(12) * G(12), 1e-10f)));
        int left = theta_obst > 0.0f;
        float row_v[2], row_o[2];
        for (int i = 0; i < 2; i++) { /* genes of a row: left, right, not influencing; far */
            float vl = G(13 + 4 * i), vr = G(14 + 4 * i), vn = G(15 + 4 * i), vf = G(16 + 4 * i);
            float ol = G(21 + 4 * i), or = G(22 + 4 * i), on = G(23 + 4 * i), of = G(24 + 4 * i);
            float v1 = vn + D * ((left ? vl : vr) - vn), v2 = vn + D * ((left ? vr : vl) - vn);
            float o1 = on + D * ((left ? ol : or) - on), o2 = -on - D * ((left ? or : ol) - on);
            float near_v = v2 + C * (v1 - v2), near_o = o2 + C * (o1 - o2);
            float far_o = of * (2.0f * C - 1.0f);
            row_v[i] = vf + B * (near_v - vf);
            row_o[i] = far_o + B * (near_o - far_o);
        }
        float v = row_v[1] + A * (row_v[0] - row_v[1]) + G(29);
        float omega = row_o[1] + A * (row_o[0] - row_o[1]) + G(30);
        v = fminf(fmaxf(0.04f * v, 0.0f), 0.2f);
        omega = fminf(fmaxf(0.3f * omega, -1.5f), 1.5f);
        b->v[n] = v;
        b->omega[n] = omega;
        b->v_peak[n] = fmaxf(b->v_peak[n], v);
        /* the exact arc */
        float length = v * dt, turn = omega * dt, q = turn * turn;
        float sinc = 1.0f - q * (1.0f / 6 - q * (1.0f / 120 - q * (1.0f / 5040)));
        float cosc = turn * (0.5f - q * (1.0f / 24 - q * (1.0f / 720 - q * (1.0f / 40320))));
        float dc = 1.0f - turn * cosc, ds = turn * sinc;
        b->x[n] = x + length * (sinc * c - cosc * s);
        b->y[n] = y + length * (sinc * s + cosc * c);
        b->cos[n] = dc * c - ds * s;
        b->sin[n] = dc * s + ds * c;
#undef G
    }
}

static void see(struct block *b, int clearance) {
    for (int n = 0; n < BLOCK; n++) {
        float bx = b->ball_x[n] - b->x[n], by = b->ball_y[n] - b->y[n], ux, uy;
        b->distance[n] = sqrtf(bx * bx + by * by);
        if (clearance)
            b->clearance[n] =
                fminf(b->clearance[n],
                      nearest(b->x[n], b->y[n], b->disc_x[n] - b->x[n], b->disc_y[n] - b->y[n],
                              b->disc_r[n], &ux, &uy));
    }
}

/* Sums over the trials of each genome.  theta: [genomes][31]; scenes: [trials][8]: start x, y,
   heading; ball x, y; obstacle x, y, radius.  Trials first <= i < last of the genomes x trials;
   sums: [genomes x trials][7] distances after steps 170, 200, 220, |v|, |omega|, lack of
   clearance squared, still. */
void rollout(const float *theta, const float *scenes, int trials, int first, int last, float dt,
             float *sums) {
    struct block b;
    for (int start = first; start < last; start += BLOCK) {
        for (int n = 0; n < BLOCK; n++) {
            /* The last block is filled up with repetitions of its last trial. */
            int pair = start + n < last ? start + n : last - 1;
            const float *s = scenes + SCENE * (pair % trials), *t = theta + GENES * (pair / trials);
            b.x[n] = s[0], b.y[n] = s[1], b.cos[n] = cosf(s[2]), b.sin[n] = sinf(s[2]);
            b.ball_x[n] = s[3], b.ball_y[n] = s[4];
            b.disc_x[n] = s[5], b.disc_y[n] = s[6], b.disc_r[n] = s[7];
            b.clearance[n] = 1e30f, b.v_peak[n] = -1e30f;
            for (int k = 0; k < GENES; k++) b.gene[k][n] = t[k];
        }
        float v_sum[BLOCK] = {0}, omega_sum[BLOCK] = {0}, distance[3][BLOCK];
        for (int k = 1, sample = 0; k <= STEPS; k++) {
            step(&b, dt);
            if (k == 170 || k == 200 || k == 220) {
                see(&b, k == STEPS);
                for (int n = 0; n < BLOCK; n++) {
                    distance[sample][n] = b.distance[n];
                    v_sum[n] += fabsf(b.v[n]), omega_sum[n] += fabsf(b.omega[n]);
                }
                sample++;
            }
        }
        for (int n = 0; n < BLOCK && start + n < last; n++) {
            float *out = sums + 7 * (start + n);
            float lack = 20.0f * fmaxf(0.145f - b.clearance[n], 0.0f);
            for (int k = 0; k < 3; k++) out[k] = distance[k][n];
            out[3] = v_sum[n] / 3, out[4] = omega_sum[n] / 3;
            out[5] = lack * lack, out[6] = b.v_peak[n] <= 0.05f;
        }
    }
}

/* F of each genome from its trials' rows. */
void fitness(const float *sums, int genomes, int trials, float *out) {
    for (int p = 0; p < genomes; p++) {
        float m[7] = {0};
        for (int t = 0; t < trials; t++)
            for (int k = 0; k < 7; k++) m[k] += sums[7 * (p * trials + t) + k] / trials;
        out[p] = 10.0f / (0.001f + 36.0f * m[1] * m[1] + m[0] + m[2] + 2.0f * m[3] + 0.5f * m[4] +
                          m[5] + 60.0f * m[6]);
    }
}
