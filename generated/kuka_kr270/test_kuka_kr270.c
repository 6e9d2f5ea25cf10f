/* Runs the self-test: exit code 0 if every stored value is reproduced. */
#include "kuka_kr270.h"

#include <stdio.h>

int main(void)
{
    double error = 0.0;
    const int status = kuka_kr270_selftest(&error);
    printf("kuka_kr270 selftest: %s, greatest relative error %.2g\n", (status == 0) ? "passed" : "failed", (double)error);
    return (status == 0) ? 0 : 1;
}
