/* zswarm's fully-meshed network in C, with any number of inputs, outputs and hidden neurons. It gives the same bits as
   zswarm/nets/fully_meshed.py. It reads genomes at run time, so nothing is compiled for a candidate.

   Compile with -std=c11 or -ffp-contract=off: fused multiply-add instructions give other bits. */

#ifndef ZSWARM_NETWORK_H
#define ZSWARM_NETWORK_H

#include <math.h>
#include <stddef.h>
#include <stdlib.h>
#include <string.h>

#if defined(__BYTE_ORDER__) && __BYTE_ORDER__ != __ORDER_LITTLE_ENDIAN__
#error "genomes are little-endian float32"
#endif

enum zswarm_activation { ZSWARM_CLAMP, ZSWARM_SIGMOID, ZSWARM_RELU, ZSWARM_TANH };

struct zswarm_network {
    int inputs, outputs, neurons, iterations; /* neurons: hidden ones, then the outputs */
    enum zswarm_activation activation;
};

/* Return the number of float32 in a genome: for each neuron the weights from all inputs and all neurons, then its bias. */
static size_t zswarm_network_genes(const struct zswarm_network *network) {
    return (size_t)network->neurons * (size_t)(network->inputs + network->neurons + 1);
}

/* Return the number of float32 in an agent's state: the neurons' last outputs, and two sums of each. They start at zero. */
static size_t zswarm_network_state(const struct zswarm_network *network) { return 3 * (size_t)network->neurons; }

/* Transpose a genome: for each source (inputs, neurons, then the bias) its weights to all neurons. */
static void zswarm_network_load(const struct zswarm_network *network, const unsigned char *genome, float *weights) {
    const int neurons = network->neurons, sources = network->inputs + neurons + 1;
    for (int neuron = 0; neuron < neurons; neuron++)
        for (int source = 0; source < sources; source++)
            memcpy(weights + source * neurons + neuron, genome + 4 * (neuron * sources + source), 4);
}

/* e to the power x: zswarm/kernels/portable.py, exp. */
static double zswarm_exp(double x) {
    if (x != x) return x;
    if (x > 709.782712893383973096) return HUGE_VAL;
    if (x < -745.13321910194110842) return 0;
    const int k = (int)(x * 1.44269504088896338700e00 + (x >= 0 ? 0.5 : -0.5));
    const double high = x - k * 6.93147180369123816490e-01, low = k * 1.90821492927058770002e-10;
    const double r = high - low, t = r * r;
    const double c = r - t * (1.66666666666666019037e-01 + t * (-2.77777777770155933842e-03 + t * (6.61375632143793436117e-05 +
                              t * (-1.65339022054652515390e-06 + t * 4.13813679705723846039e-08))));
    const double y = 1.0 - ((low - (r * c) / (2.0 - c)) - high);
    return k == 1024 ? y * 2.0 * ldexp(1.0, 1023) : y * ldexp(1.0, k);
}

/* zswarm/kernels/portable.py, tanh. */
static float zswarm_tanh(float x) {
    const int negative = x < 0;
    float size = negative ? 0 - x : x;
    if (size > 20) size = 20;
    const float t1 = (float)0.49962949, t2 = (float)0.12714170, t3 = (float)0.01738343, t4 = (float)0.00450478;
    const float root = 1 + size * (t1 + size * (t2 + size * (t3 + size * t4)));
    const float square = root * root, y = 1 - 2 / (square * square + 1);
    return negative ? 0 - y : y;
}

static float zswarm_activate(enum zswarm_activation activation, float sum) {
    switch (activation) {
    case ZSWARM_CLAMP: sum = sum < 0 ? 0 : sum; return sum > 1 ? 1 : sum;
    case ZSWARM_RELU: return sum < 0 ? 0 : sum;
    case ZSWARM_TANH: return zswarm_tanh(sum);
    default: return (float)(1.0 / (1.0 + zswarm_exp(-(double)sum)));
    }
}

static void zswarm_network_add(int neurons, float *sums, const float *weights, float value) {
    for (int neuron = 0; neuron < neurons; neuron++) {
        const float product = weights[neuron] * value;
        sums[neuron] += product;
    }
}

/* Decide once. Sums run over the sources in order; the inputs' part is the same in each iteration. */
static void zswarm_network_decide(const struct zswarm_network *network, const float *weights, float *state,
                                  const float *observation, float *action) {
    const int neurons = network->neurons, inputs = network->inputs;
    const float *inner = weights + inputs * neurons, *biases = inner + neurons * neurons;
    float *from_inputs = state + neurons, *sums = state + 2 * neurons;
    for (int neuron = 0; neuron < neurons; neuron++) from_inputs[neuron] = 0;
    for (int input = 0; input < inputs; input++)
        zswarm_network_add(neurons, from_inputs, weights + input * neurons, observation[input]);
    for (int iteration = 0; iteration < network->iterations; iteration++) {
        memcpy(sums, from_inputs, sizeof(float) * (size_t)neurons);
        for (int neuron = 0; neuron < neurons; neuron++)
            zswarm_network_add(neurons, sums, inner + neuron * neurons, state[neuron]);
        for (int neuron = 0; neuron < neurons; neuron++)
            state[neuron] = zswarm_activate(network->activation, biases[neuron] + sums[neuron]);
    }
    memcpy(action, state + neurons - network->outputs, sizeof(float) * (size_t)network->outputs);
}

/* Return whether this program was compiled without fused multiply-add. */
static int zswarm_network_is_exact(void) {
    volatile float number = 1 + 1.0f / 4096, square = number * number; /* volatile: compute at run time, not in the compiler */
    const float one = number, other = number, product = one * other;
    float sum = -square;
    sum += product;
    return sum == 0;
}

#endif
