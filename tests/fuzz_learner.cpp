// Updates of learners of many shapes, for a build with sanitizers; see test_native.py. Every array
// is of its own and exactly as long as it must be, so that a step past its end is a report.

#include "learner.cpp"

#include <cstdio>
#include <random>
#include <vector>

static std::mt19937 random_bits(1);
static int upto(int most) { return (int)(random_bits() % (unsigned)(most + 1)); }

static std::vector<uint8_t> screens(int count, int stack) {
  std::vector<uint8_t> pixels((size_t)count * PIXELS * PIXELS * stack);
  const int kind = upto(2);  // black, a still background with noise in places, noise everywhere
  for (uint8_t& pixel : pixels) pixel = kind == 0 ? 0 : kind == 1 ? 90 * !upto(40) : upto(255);
  return pixels;
}

static void learn(int stack, int actions, int dueling, int double_q, int batch, int frozen,
                  int updates = 2) {
  Learner* learner = learner_new(stack, actions, dueling, double_q);
  const long size = learner_layout(learner)[PARTS];
  for (int which = 0; which < 2; which++) {
    float* weights = learner_array(learner, which);
    for (long i = 0; i < size; i++) weights[i] = ((int)upto(1023) - 512) / 8192.0f;
  }
  learner_transform(learner);
  for (int update = 1, B = batch; update <= updates; update++, B = 1 + upto(batch)) {
    const std::vector<uint8_t> s_tm1 = screens(B, stack), s_t = screens(B, stack);
    std::vector<int64_t> a_tm1(B);
    std::vector<float> r_t(B), discount_t(B), q((size_t)B * actions);
    for (int b = 0; b < B; b++) {
      a_tm1[b] = upto(actions - 1), r_t[b] = upto(2) - 1.0f, discount_t[b] = upto(4) ? 0.99f : 0;
    }
    double loss_and_q[2];
    if (!learner_update(learner, s_tm1.data(), a_tm1.data(), r_t.data(), discount_t.data(),
                        s_t.data(), B, frozen, 1e-4, 1e-8, update, loss_and_q) ||
        !learner_q_values(learner, s_t.data(), B, q.data()))
      std::abort();
    learner_update_target(learner, upto(1) ? 1.0f : 0.3f);
    if (!(loss_and_q[0] >= 0)) std::abort();
  }
  learner_free(learner);
}

int main() {
  // stack, actions, dueling, double_q, batch, frozen: the ends of each range, and what lies between
  learn(4, 18, 1, 1, 2, 0);
  learn(1, 1, 0, 0, 1, 0);
  learn(8, 17, 0, 1, 1, 1);
  learn(1, 4, 0, 1, 17, 0, 1);  // more images than a register holds, and tiles than a group
  for (int i = 0; i < 2; i++)
    learn(1 + upto(7), 1 + upto(17), upto(1), 1, 1 + upto(2), upto(3) == 0, 1);
  std::puts("done");
}
