/* How a controller uses the model: correct a joint command for the load it carries. */
#include "ur10.h"

#include <stdio.h>

int main(void)
{
    const double q[UR10_N_JOINTS] = {-0.599, 0.751, 5.331, -0.432, 0.099, 1.098};
    const double w[6] = {0.0, 0.0, -1000.0, 0.0, 0.0, 0.0}; /* N, N*m on the robot at the tool centre point, base axes */
    double dt[6];
    double q_cmd[UR10_N_JOINTS];
    int i;
    int status;
    status = ur10_deflection(&ur10_default_params, q, w, dt);
    if (status != UR10_OK) {
        printf("deflection: error %d\n", status);
        return 1;
    }
    printf("deflection [mm]: %.4f %.4f %.4f\n", (double)dt[0] * 1e3, (double)dt[1] * 1e3, (double)dt[2] * 1e3);
    status = ur10_compensate(&ur10_default_params, q, w, q_cmd);
    if (status != UR10_OK) {
        printf("compensate: error %d, the command stays as it was\n", status);
    }
    for (i = 0; i < UR10_N_JOINTS; ++i) {
        printf("q%d: %.6f -> %.6f\n", i + 1, (double)q[i], (double)q_cmd[i]);
    }
    return 0;
}
