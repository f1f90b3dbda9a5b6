// SPDX-License-Identifier: MIT OR GPL-2.0
/*
 * An I2C front of the kernel's driver inv_icm42600 that binds by name. The driver's own front of Linux 6.1 binds only
 * to devices of a device tree, which a PC has not. All that reads and decodes is the kernel's.
 */
#include <linux/i2c.h>
#include <linux/module.h>
#include <linux/regmap.h>

#include "inv_icm42600.h"

static int keep_the_bus(struct inv_icm42600_state *state)
{
	return 0;
}

static int probe_icm42605(struct i2c_client *client)
{
	struct regmap *map = devm_regmap_init_i2c(client, &inv_icm42600_regmap_config);

	if (IS_ERR(map))
		return PTR_ERR(map);
	return inv_icm42600_core_probe(map, INV_CHIP_ICM42605, client->irq, keep_the_bus);
}

static const struct i2c_device_id names[] = { { "icm42605-by-name", 0 }, { } };
MODULE_DEVICE_TABLE(i2c, names);

static struct i2c_driver icm42605_by_name = {
	.driver = { .name = "icm42605-by-name" },
	.probe_new = probe_icm42605,
	.id_table = names,
};
module_i2c_driver(icm42605_by_name);
MODULE_LICENSE("Dual MIT/GPL");
MODULE_DESCRIPTION("inv_icm42600 for a device that is named, not described");
