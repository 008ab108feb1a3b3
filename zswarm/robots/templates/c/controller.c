/* See @{unit}.h. */
#include "@{unit}.h"

@{includes}
@{guards}
@{definitions}
void @{unit}_reset(@{unit}_state *state)
{
    for (int32_t at = 0; at < @{macro}_STATE; at++) {
        state->x[at] = 0.0f;
    }
}

void @{unit}_step(@{unit}_state *state, const float observation[@{macro}_INPUTS], float action[@{macro}_OUTPUTS])
{
@{call}
}

#if !defined(@{macro}_NO_SELFTEST)
static const float @{unit}_observations[@{steps}][@{macro}_INPUTS] = {
@{observations}
};

static const float @{unit}_actions[@{steps}][@{macro}_OUTPUTS] = {
@{actions}
};

/* A digest of the state after each step: it shows differences before decisions do. */
static const uint32_t @{unit}_states[@{steps}] = {
@{states}
};

/* A number's bits; all NaNs have the same. */
static uint32_t @{unit}_bits(float number)
{
    union {
        float number;
        uint32_t bits;
    } both;
    both.number = number;
    return (number != number) ? 2143289344U : both.bits;
}

/* FNV-1a over words instead of bytes. */
static uint32_t @{unit}_digest(const @{unit}_state *state)
{
    uint32_t digest = 2166136261U;
    for (int32_t at = 0; at < @{macro}_STATE; at++) {
        digest = (digest ^ @{unit}_bits(state->x[at])) * 16777619U;
    }
    return digest;
}

int @{unit}_selftest(void)
{
    @{unit}_state state;
    float action[@{macro}_OUTPUTS];
    int differs = 0;
    @{unit}_reset(&state);
    for (int step = 0; (step < @{steps}) && (differs == 0); step++) {
        @{unit}_step(&state, @{unit}_observations[step], action);
        for (int at = 0; at < @{macro}_OUTPUTS; at++) {
            if (@{unit}_bits(action[at]) != @{unit}_bits(@{unit}_actions[step][at])) {
                differs = step + 1;
            }
        }
        if (@{unit}_digest(&state) != @{unit}_states[step]) {
            differs = step + 1;
        }
    }
    return differs;
}

#if defined(@{macro}_MAIN)
int main(void)
{
    return @{unit}_selftest();
}
#endif
#endif
